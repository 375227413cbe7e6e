// End of a frame, backward Euler: v += a, x = trial = x + v; at a handle v = trial - x, what it moved in this frame.
//
// a, trial, x, v: [B, 3, n]; slots: [B, n]. One invocation: one particle's component. Workgroups: (n / 64, 3 B).
// Adjoint: none, the state is a constant of the training step.

struct Params {
    particles: u32, // n
    pad0: u32,
    pad1: u32,
    pad2: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> slots: array<u32>;
@group(0) @binding(2) var<storage, read> a: array<f32>;
@group(0) @binding(3) var<storage, read> trial: array<f32>;
@group(0) @binding(4) var<storage, read_write> x: array<f32>;
@group(0) @binding(5) var<storage, read_write> v: array<f32>;

@compute @workgroup_size(64)
fn integrate(@builtin(global_invocation_id) id: vec3u) {
    let p = id.x;
    if p >= params.particles {
        return;
    }
    let at = id.y * params.particles + p;
    let slot = slots[id.y / 3u * params.particles + p];
    let next = trial[at];
    v[at] = select(v[at] + a[at], next - x[at], slot != 0u);
    x[at] = next;
}
