// Gradient of the weight and bias of a head with one output:
//   weight[c] += sum_{l, j} adj[l, j] x[l, c, j]
//   bias += sum_{l, j} adj[l, j]
//
// x: [lines, C, W']; for the scalar head, the pooled values with one line per sample and W' = 1
// adj: [lines, W'], zero in the padding
// gradient: the weight [C] first, the bias at element `bias`
//
// One workgroup per channel, and one for the bias after them. Its invocations add up in a fixed order.
// Workgroups: (C + 1).
// Adjoint: none, it is one.

struct Params {
    channels: u32, // C
    width: u32, // W'
    lines: u32,
    bias: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> adj: array<f32>;
@group(0) @binding(3) var<storage, read_write> gradient: array<f32>;

var<workgroup> partial: array<f32, 256>;

@compute @workgroup_size(256)
fn head_weight_adj(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let channel = group.x;
    let is_bias = channel == params.channels;
    let all = params.lines * params.width;
    var sum = 0.0;
    for (var k = lane; k < all; k += 256u) {
        var value = 1.0;
        if !is_bias {
            value = x[(k / params.width * params.channels + channel) * params.width + k % params.width];
        }
        sum += adj[k] * value;
    }
    partial[lane] = sum;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    if lane == 0u {
        gradient[select(channel, params.bias, is_bias)] += partial[0];
    }
}
