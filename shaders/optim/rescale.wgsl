// Persistent scale of each sample: scale <- scale exp(2 tanh(scalar / 2) - 1) (update rule of the paper's section 3.3).
//
// scalar: [S]; scale: from element `before` on [S], to be written from element `after` on.
// One invocation: one sample. Workgroups: (S / 64).
// Adjoint: `update_adj`.

struct Params {
    samples: u32, // S
    before: u32,
    after: u32,
    pad: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> scalar: array<f32>;
@group(0) @binding(2) var<storage, read_write> scale: array<f32>;

@compute @workgroup_size(64)
fn rescale(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.samples {
        return;
    }
    let half = tanh_exact(vec4f(0.5 * scalar[id.x])).x;
    scale[params.after + id.x] = scale[params.before + id.x] * exp(2.0 * half - 1.0);
}
