// Sums a vector in parts: sums[part] = sum x[k]^2 over the part, or sum x[k] without SQUARE, where x already
// holds sums of squares.
//
// x: [n]
// sums: [parts]
//
// One workgroup per part. Its invocations add up in a fixed order. Workgroups: (parts).
// Adjoint: none, the norm of a gradient is not differentiated.

struct Params {
    n: u32,
    parts: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

override SQUARE: bool = true;

var<workgroup> partial: array<f32, 256>;

@compute @workgroup_size(256)
fn squares(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let per_part = (params.n + params.parts - 1u) / params.parts;
    let begin = group.x * per_part;
    let end = min(begin + per_part, params.n);
    var sum = 0.0;
    for (var k = begin + lane; k < end; k += 256u) {
        let value = x[k];
        sum += select(value, value * value, SQUARE);
    }
    partial[lane] = sum;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    if lane == 0u {
        sums[group.x] = partial[0];
    }
}
