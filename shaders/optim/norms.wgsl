// Partial sums of squares for the norms of a sample: partial_sums[s, k] = (sum g^2, sum d^2) over the k-th part of its particles.
//
// grad: [S, n]; hidden: [2, S, n], of which the second half, the last step, is read (the first is the last gradient);
// partial_sums: [S, parts, 2] from sum `first` on. Without an update rule (LAST_STEP false) the second sum is 0 and nothing is
// read for it.
// One workgroup: one part; its invocations add up in a fixed order. Workgroups: (parts, S).
// Adjoint: none, the norms are constants of the training step (paper section 3.3).

struct Params {
    particles: u32, // n
    parts: u32,
    samples: u32, // S
    first: u32, // sum that is the first of partial_sums
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read> hidden: array<f32>;
@group(0) @binding(3) var<storage, read_write> partial_sums: array<vec2f>;

override LAST_STEP: bool = true;

var<workgroup> partial: array<vec2f, 64>;

@compute @workgroup_size(64)
fn norms(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let sample = group.y;
    let per_part = (params.particles + params.parts - 1u) / params.parts;
    let begin = group.x * per_part;
    let end = min(begin + per_part, params.particles);
    var sum = vec2f();
    for (var p = begin + lane; p < end; p += 64u) {
        let at = sample * params.particles + p;
        let g = grad[at];
        sum.x += g * g;
        if LAST_STEP {
            let d = hidden[params.samples * params.particles + at];
            sum.y += d * d;
        }
    }
    partial[lane] = sum;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    if lane == 0u {
        partial_sums[params.first + sample * params.parts + group.x] = partial[0];
    }
}
