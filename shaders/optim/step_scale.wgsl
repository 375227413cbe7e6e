// The scales with which a network's steps begin where they are directions among others: the size of the last step, its root
// mean square for each component of a cloth, at least LEAST_SHARE of the largest; those before for a cloth without a step.
//
// sums: [S, parts, 2], partial sums of the squares of the gradient and the last step
// scale: [S] from element `after` on, set to these, or to those from element `before` on
//
// One workgroup per cloth, of 64 invocations for each component. Workgroups: (B).
// Adjoint: none, training has no directions.

struct Params {
    particles: u32, // n
    parts: u32,
    first_sum: u32,
    before: u32,
    after: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sums: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> scale: array<f32>;

const LEAST_SHARE: f32 = 0.01;

var<workgroup> squares: array<f32, 192>;

@compute @workgroup_size(64, 3)
fn step_scale(@builtin(local_invocation_id) local: vec3u, @builtin(workgroup_id) group: vec3u) {
    let sample = 3u * group.x + local.y;
    let own = 64u * local.y + local.x;
    var sum = 0.0;
    for (var part = local.x; part < params.parts; part += 64u) {
        sum += sums[params.first_sum + sample * params.parts + part].y;
    }
    squares[own] = sum;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if local.x < half {
            squares[own] += squares[own + half];
        }
    }
    workgroupBarrier();
    let largest = max(squares[0], max(squares[64], squares[128]));
    if local.x == 0u {
        var size = scale[params.before + sample];
        if largest > 0.0 && is_finite(largest) {
            size = max(sqrt(squares[own]), LEAST_SHARE * sqrt(largest)) / sqrt(f32(params.particles));
        }
        scale[params.after + sample] = size;
    }
}
