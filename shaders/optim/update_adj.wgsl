// Backward pass of the update rule, with the authors' rule in place of the true adjoint (paper section 3.3).
//
// step = scale tanh(field). The cotangents of tanh(field) and of 2 tanh(scalar / 2) - 1 are divided by norms
// and clamped to -CLAMP..CLAMP. Each norm is the root mean square of the norms of a group of samples. With
// groups of one sample, every component of every cloth has the same weight, whatever its energies.
// The cotangent of the step is grad, that of the loss, times any positive factor, which the division cancels.
// Norms have a floor of 1e-30, so that the cotangents of a cloth in equilibrium are 0.
//
// field: [S, H, Q] quads
// scalar: [S]
// scale: [S], after the step
// grad: [S, H, W]
// adj_field: [S, H, Q] quads, zero in the padding
// adj_scalar: [S]
//
// One workgroup per sample. Its invocations add up in a fixed order. Each workgroup computes the sums of its
// whole group.
// Workgroups: (S).
// Adjoint: none, it is one.

struct Params {
    rows: u32, // H
    columns: u32, // W
    stride: u32, // W' = 4 Q
    share: f32, // factor of grad
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read> scalar: array<f32>;
@group(0) @binding(3) var<storage, read> scale: array<f32>;
@group(0) @binding(4) var<storage, read> grad: array<f32>;
@group(0) @binding(5) var<storage, read_write> adj_field: array<f32>;
@group(0) @binding(6) var<storage, read_write> adj_scalar: array<f32>;

// Samples per group, at most 3.
override TOGETHER: u32 = 1u;

// Bound of a normalised cotangent.
override CLAMP: f32;
// The CPU's 1e-40 would be subnormal here.
const FLOOR: f32 = 1e-30;

// (sum grad^2, sum grad tanh(field)).
var<workgroup> partial: array<vec2f, 256>;

@compute @workgroup_size(256)
fn update_adj(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let sample = group.x;
    let all = params.rows * params.stride;
    let first = sample * params.rows * params.columns;
    let step_scale = params.share * scale[sample];
    // Per sample of the group: the norm of the cotangent of tanh(field), and the cotangent of the exponent.
    var sizes: array<vec2f, 3>;
    let begin = sample / TOGETHER * TOGETHER;
    for (var k = 0u; k < TOGETHER; k += 1u) {
        let sums = sums_of(begin + k, lane);
        sizes[k] = params.share * scale[begin + k] * vec2f(sqrt(sums.x), sums.y);
    }
    // Squares are relative to the largest, so that none that matters underflows.
    var largest = vec2f(FLOOR);
    for (var k = 0u; k < TOGETHER; k += 1u) {
        largest = max(largest, abs(sizes[k]));
    }
    var squares = vec2f();
    for (var k = 0u; k < TOGETHER; k += 1u) {
        let part = sizes[k] / largest;
        squares += part * part;
    }
    let norms = max(largest * sqrt(squares / f32(TOGETHER)), vec2f(FLOOR));
    if lane == 0u {
        let normalised = clamp(sizes[sample - begin].y / norms.y, -CLAMP, CLAMP);
        let t = tanh_exact(vec4f(0.5 * scalar[sample])).x;
        adj_scalar[sample] = normalised * (1.0 - t * t);
    }
    let factor = step_scale / norms.x;
    for (var k = lane; k < all; k += 256u) {
        let column = k % params.stride;
        var value = 0.0;
        if column < params.columns {
            let g = grad[first + k / params.stride * params.columns + column];
            let u = tanh_exact(vec4f(field[sample * all + k])).x;
            value = clamp(g * factor, -CLAMP, CLAMP) * (1.0 - u * u);
        }
        adj_field[sample * all + k] = value;
    }
}

// Returns the sums of a sample, the same in every invocation.
fn sums_of(sample: u32, lane: u32) -> vec2f {
    let all = params.rows * params.stride;
    let first = sample * params.rows * params.columns;
    var sums = vec2f();
    for (var k = lane; k < all; k += 256u) {
        let column = k % params.stride;
        if column < params.columns {
            let g = grad[first + k / params.stride * params.columns + column];
            sums += vec2f(g * g, g * tanh_exact(vec4f(field[sample * all + k])).x);
        }
    }
    // Wait until all invocations have read the sums of the previous sample.
    workgroupBarrier();
    partial[lane] = sums;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    workgroupBarrier();
    return partial[0];
}
