// Gradient descent: a -= rate grad.
//
// grad, a: [B, 3, n]
//
// One invocation per component of a particle. Workgroups: (n / 64 over x and y, 3 B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    particles: u32, // n
    rate: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read_write> a: array<f32>;

@compute @workgroup_size(64)
fn gradient_descent(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.particles {
        return;
    }
    let at = group.z * params.particles + p;
    a[at] -= params.rate * grad[at];
}
