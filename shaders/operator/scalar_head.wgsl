// Scalar head: scalar[s] = bias + sum_c weight[c] max_i rows_max[s, i, c].
//
// With RESCALE, also updates the persistent scale, scale <- scale exp(2 tanh(scalar / 2) - 1) (update rule,
// paper section 3.3). Where a dispatch of only one workgroup per sample would hold up all later ones,
// `update` computes the new scale instead.
//
// weight: [C]
// bias: [1]
// rows_max: [S, H, C], H at least TEAMS
// scalar: [S]
// scale: [S] read from element `before` on, [S] written from element `after` on
//
// One workgroup per sample. Workgroups: (S).
// Adjoint: `pool_adj` (x), `head_weight_adj` (weight, bias), `update_adj` (scale).

struct Params {
    channels: u32, // C
    rows: u32, // H
    before: u32,
    after: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> bias: array<f32>;
@group(0) @binding(3) var<storage, read> rows_max: array<f32>;
@group(0) @binding(4) var<storage, read_write> scalar: array<f32>;
@group(0) @binding(5) var<storage, read_write> scale: array<f32>;

override RESCALE: bool = true;

@compute @workgroup_size(64, TEAMS)
fn scalar_head(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3u) {
    let sample = group.x;
    let value = scalar_of(sample, params.rows, params.channels, index);
    if index == 0u {
        scalar[sample] = value;
        if RESCALE {
            scale[params.after + sample] = rescaled(scale[params.before + sample], value);
        }
    }
}
