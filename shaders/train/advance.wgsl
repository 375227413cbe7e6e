// Ends the frame of the cloths of a batch that have done all their iterations:
//   x += base + a, v = keep (base + a), a = 0
//   x = target, v = 0, a = 0 at a handle
// The velocity of handles is 0 as in the authors' pools, not as in a rollout (paper section 3.3).
//
// drawn: [B]
// marks: [B, n]
// targets: [handles, 3]
// base, x, v, a: [B, 3, n]
//
// One invocation per component of a particle. Workgroups: (n / 64, 3 B).
// Adjoint: none, the state is a constant of the training step.

struct Params {
    particles: u32, // n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> drawn: array<Drawn>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> targets: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read_write> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> v: array<f32>;
@group(0) @binding(7) var<storage, read_write> a: array<f32>;

@compute @workgroup_size(64)
fn advance(@builtin(global_invocation_id) id: vec3u) {
    let p = id.x;
    if p >= params.particles || drawn[id.y / 3u].advance == 0u {
        return;
    }
    let at = id.y * params.particles + p;
    let mark = marks[id.y / 3u * params.particles + p];
    if is_free(mark) {
        let shift = base[at] + a[at];
        v[at] = drawn[id.y / 3u].keep * shift;
        x[at] += shift;
    } else {
        v[at] = 0.0;
        x[at] = target_of(slot_of(mark), id.y % 3u);
    }
    a[at] = 0.0;
}
