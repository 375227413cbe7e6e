// Scalar head: scalar[s] = bias + sum_c weight[c] max_i rows_max[s, i, c].
//
// rows_max: [S, H, C]; weight: [C]; bias: [1]; scalar: [S].
// One workgroup: one sample; its invocations take channels in turn and add up in a fixed order. Workgroups: (S).
// Adjoint: `pool_adj` (x), `head_weight_adj` (weight, bias).

struct Params {
    channels: u32, // C
    rows: u32, // H
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> bias: array<f32>;
@group(0) @binding(3) var<storage, read> rows_max: array<f32>;
@group(0) @binding(4) var<storage, read_write> scalar: array<f32>;

var<workgroup> partial: array<f32, 64>;

@compute @workgroup_size(64)
fn scalar_head(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let sample = group.x;
    var sum = 0.0;
    for (var c = lane; c < params.channels; c += 64u) {
        let first = sample * params.rows * params.channels + c;
        var most = rows_max[first];
        for (var i = 1u; i < params.rows; i++) {
            most = max(most, rows_max[first + i * params.channels]);
        }
        sum += weight[c] * most;
    }
    partial[lane] = sum;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    if lane == 0u {
        scalar[sample] = partial[0] + bias[0];
    }
}
