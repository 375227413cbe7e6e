// End of a frame (backward Euler): v = base + a, x += v; at a handle v = base, and x is exactly the target.
//
// marks: [B, n]
// targets: [handles, 3]
// base, a, x, v: [B, 3, n]
//
// One invocation per component of a particle. Workgroups: (n / 64 over x and y, 3 B in z).
// Adjoint: none, the state is a constant of the training step.

struct Params {
    particles: u32, // n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> targets: array<f32>;
@group(0) @binding(3) var<storage, read> base: array<f32>;
@group(0) @binding(4) var<storage, read> a: array<f32>;
@group(0) @binding(5) var<storage, read_write> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> v: array<f32>;

@compute @workgroup_size(64)
fn integrate(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.particles {
        return;
    }
    let at = group.z * params.particles + p;
    let mark = marks[group.z / 3u * params.particles + p];
    let shift = base[at] + select(0.0, a[at], is_free(mark));
    var next = x[at] + shift;
    if !is_free(mark) && !is_outside(mark) {
        next = target_of(slot_of(mark), group.z % 3u);
    }
    v[at] = shift;
    x[at] = next;
}
