// Adam with bias correction.
//
// m <- beta1 m + (1 - beta1) g
// v <- beta2 v + (1 - beta2) g^2
// a -= rate m / (1 - beta1^t) / (sqrt(v / (1 - beta2^t)) + epsilon)
// At t = 1, the first iteration of a frame, the moments start from zero whatever they hold.
//
// grad, a: [B, 3, n]
// moments: [B, 3, n, 2] = (m, v)
//
// One invocation per component of a particle. Workgroups: (n / 64 over x and y, 3 B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    particles: u32, // n
    first: u32, // 1 in the first iteration
    rate: f32,
    beta1: f32,
    beta2: f32,
    epsilon: f32,
    correction1: f32, // 1 / (1 - beta1^t)
    correction2: f32, // 1 / (1 - beta2^t)
    weight1: f32, // 1 - beta1
    weight2: f32, // 1 - beta2
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read_write> moments: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> a: array<f32>;

@compute @workgroup_size(64)
fn adam(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.particles {
        return;
    }
    let at = group.z * params.particles + p;
    let g = grad[at];
    let beta = vec2f(params.beta1, params.beta2);
    let before = select(moments[at], vec2f(), params.first != 0u);
    let now = beta * before + vec2f(params.weight1, params.weight2) * vec2f(g, g * g);
    moments[at] = now;
    let denominator = sqrt(now.y * params.correction2) + params.epsilon;
    a[at] -= params.rate * now.x * params.correction1 / denominator;
}
