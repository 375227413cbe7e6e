// AdamW on the whole weight vector (Loshchilov and Hutter 2019), with the gradient clipped to a norm, and the
// running mean of the weights.
//
// g <- clip gradient
// m <- beta1 m + (1 - beta1) g
// v <- beta2 v + (1 - beta2) g^2
// w <- decay w - step_size m / (sqrt(v) / sqrt_correction + epsilon)
// averaged <- average averaged + (1 - average) w
// The host computes the factors in double precision:
//   clip = min(largest norm / (norm + 1e-6), 1), decay = 1 - rate weight_decay
//   step_size = rate / (1 - beta1^t), sqrt_correction = sqrt(1 - beta2^t)
//
// factors: one `Factors`
// gradient, weight (w), mean (m), square (v), averaged: [n]
//
// One invocation per weight. Workgroups: (n / 64 over x and y).
// Adjoint: none, it is the optimizer.

struct Params {
    n: u32,
}

struct Factors {
    clip: f32,
    decay: f32,
    step_size: f32,
    sqrt_correction: f32,
    beta1: f32,
    beta2: f32,
    add1: f32, // 1 - beta1
    add2: f32, // 1 - beta2
    epsilon: f32,
    average: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> factors: Factors;
@group(0) @binding(2) var<storage, read> gradient: array<f32>;
@group(0) @binding(3) var<storage, read_write> weight: array<f32>;
@group(0) @binding(4) var<storage, read_write> mean: array<f32>;
@group(0) @binding(5) var<storage, read_write> square: array<f32>;
@group(0) @binding(6) var<storage, read_write> averaged: array<f32>;

@compute @workgroup_size(64)
fn adamw(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let k = (group.y * groups.x + group.x) * 64u + lane;
    if k >= params.n {
        return;
    }
    let g = factors.clip * gradient[k];
    let m = factors.beta1 * mean[k] + factors.add1 * g;
    let v = factors.beta2 * square[k] + factors.add2 * g * g;
    let w = factors.decay * weight[k]
        - factors.step_size * m / (sqrt(v) / factors.sqrt_correction + factors.epsilon);
    mean[k] = m;
    square[k] = v;
    weight[k] = w;
    averaged[k] = factors.average * averaged[k] + (1.0 - factors.average) * w;
}
