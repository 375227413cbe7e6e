// Scalar head: scalar[s] = bias + sum_c weight[c] max_i rows_max[s, i, c]; and, with RESCALE, the persistent scale of the sample:
// scale <- scale exp(2 tanh(scalar / 2) - 1) (update rule of the paper's section 3.3). Where one workgroup to a sample would keep
// all others waiting, `update` does this.
//
// rows_max: [S, H, C]; weight: [C]; bias: [1]; scalar: [S]; scale: from element `before` on [S], to be written from element `after`
// on. H is at least TEAMS.
// One workgroup: one sample. Workgroups: (S).
// Adjoint: `pool_adj` (x), `head_weight_adj` (weight, bias), `update_adj` (the scale).

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
