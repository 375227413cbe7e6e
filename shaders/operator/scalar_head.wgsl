// Scalar head: scalar[s] = bias + sum_c weight[c] max_i rows_max[s, i, c].
//
// With RESCALE, also updates the persistent scale, scale <- scale exp(2 tanh(scalar / 2) - 1) (update rule,
// paper section 3.3), with OF_STEP that of the last step (`size_of_step`). Where a dispatch of only one workgroup per sample would hold up all
// later ones, `update` computes the new scale instead.
//
// head: weight [C], and the bias at element `bias`
// rows_max: [s, H, C], H at least TEAMS
// sums: [S, parts, 2] from sum `first_sum` on, of which the s samples from `first` on are these
// scalar: [s]
// scale: [s] read from element `before` on, [s] written from element `after` on
//
// One workgroup per sample. Workgroups: (s).
// Adjoint: `pool_adj` (x), `head_weight_adj` (weight, bias), `update_adj` (scale).

struct Params {
    channels: u32, // C
    bias: u32,
    rows: u32, // H
    before: u32,
    after: u32,
    particles: u32,
    parts: u32,
    first_sum: u32,
    first: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> head: array<f32>;
@group(0) @binding(2) var<storage, read> rows_max: array<f32>;
@group(0) @binding(3) var<storage, read> sums: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> scalar: array<f32>;
@group(0) @binding(5) var<storage, read_write> scale: array<f32>;

override RESCALE: bool = true;

@compute @workgroup_size(64, TEAMS)
fn scalar_head(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3u) {
    let sample = group.x;
    let value = scalar_of(sample, params.rows, params.channels, params.bias, index);
    var before = 0.0;
    if RESCALE {
        before = scale[params.before + sample];
        if OF_STEP {
            let last = LastStep(params.particles, params.parts, params.first_sum);
            before = size_of_step(params.first + sample, last, before, index);
        }
    }
    if index == 0u {
        scalar[sample] = value;
        if RESCALE {
            scale[params.after + sample] = rescaled(before, value);
        }
    }
}
