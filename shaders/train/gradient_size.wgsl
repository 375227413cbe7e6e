// Mean magnitude of the gradient over particles and components of a cloth: sizes[b] = sum |grad[b]| / (3 n).
//
// grad: [B, 3 n]
// sizes: [B]
//
// One workgroup per cloth. Its invocations add up in a fixed order. Workgroups: (B).
// Adjoint: none, the value is only reported.

struct Params {
    elements: u32, // 3 n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read_write> sizes: array<f32>;

var<workgroup> partial: array<f32, 256>;

@compute @workgroup_size(256)
fn gradient_size(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    var sum = 0.0;
    for (var k = lane; k < params.elements; k += 256u) {
        sum += abs(grad[group.x * params.elements + k]);
    }
    partial[lane] = sum;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    if lane == 0u {
        sizes[group.x] = partial[0] / f32(params.elements);
    }
}
