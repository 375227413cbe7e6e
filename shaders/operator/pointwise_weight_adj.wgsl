// Gradient of the weight and bias of a pointwise layer, in parts:
//   weight[o, i] = sum_{l, j} adj[l, o, j] x[l, i, j]
//   bias[o] = sum_{l, j} adj[l, o, j]
// Each part sums over a share of the positions j of some lines l. `sum_parts` adds the parts up in order.
//
// x: [lines, I, Q] quads
// adj: [lines, O, Q] quads, zero in the padding
// partial: [parts, stride] quads of outputs: the weight in the order of the layer, [O / tile, I, tile], the
//   bias from `bias` on, and zeros between them
//
// One workgroup per 32 outputs by 32 inputs, 4 by 4 to an invocation. 32 positions at a time pass through
// workgroup memory as [position, quad of channels].
// Workgroups: (O / 32 * I / 32, parts).
// Adjoint: none, it is one (with respect to the weight; with respect to x it is `pointwise` with the
// `transpose`d weight).

struct Params {
    inputs: u32, // I
    outputs: u32, // O
    quads: u32, // per channel, in all lines of the dispatch
    row_quads: u32, // Q
    parts: u32,
    x_first: u32, // first line of x
    adj_first: u32, // first line of adj
    tile: u32,
    stride: u32, // quads of a part
    bias: u32, // offset of the bias in a part, in quads
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<vec4f>;
@group(0) @binding(2) var<storage, read> adj: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> partial: array<vec4f>;

var<workgroup> x_tile: array<vec4f, 256>;
var<workgroup> adj_tile: array<vec4f, 256>;

@compute @workgroup_size(64)
fn pointwise_weight_adj(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
) {
    let across = (params.inputs + 31u) / 32u;
    // Each invocation loads four channels of one quad of positions, and sums the channel quads `out_quad` and
    // `in_quad`. Neighbouring invocations load different channels, so that their stores are contiguous.
    let channels = lane % 8u;
    let quad = lane / 8u;
    let out_quad = group.x / across * 8u + lane / 8u;
    let in_quad = group.x % across * 8u + lane % 8u;
    let x_channel = group.x % across * 32u + 4u * channels;
    let adj_channel = group.x / across * 32u + 4u * channels;
    let per_part = (params.quads + params.parts - 1u) / params.parts;
    let begin = group.y * per_part;
    let end = min(begin + per_part, params.quads);
    var sum0 = vec4f();
    var sum1 = vec4f();
    var sum2 = vec4f();
    var sum3 = vec4f();
    var bias = vec4f();
    for (var first = begin; first < end; first += 8u) {
        let q = first + quad;
        var a = mat4x4f();
        var b = mat4x4f();
        if q < end {
            let line = q / params.row_quads;
            let column = q % params.row_quads;
            let adj_from = ((params.adj_first + line) * params.outputs + adj_channel) * params.row_quads + column;
            let x_from = ((params.x_first + line) * params.inputs + x_channel) * params.row_quads + column;
            // Unrolled by hand: DirectX's older compiler drops stores at a variable index.
            if adj_channel < params.outputs { a[0] = adj[adj_from]; }
            if adj_channel + 1u < params.outputs { a[1] = adj[adj_from + params.row_quads]; }
            if adj_channel + 2u < params.outputs { a[2] = adj[adj_from + 2u * params.row_quads]; }
            if adj_channel + 3u < params.outputs { a[3] = adj[adj_from + 3u * params.row_quads]; }
            if x_channel < params.inputs { b[0] = x[x_from]; }
            if x_channel + 1u < params.inputs { b[1] = x[x_from + params.row_quads]; }
            if x_channel + 2u < params.inputs { b[2] = x[x_from + 2u * params.row_quads]; }
            if x_channel + 3u < params.inputs { b[3] = x[x_from + 3u * params.row_quads]; }
        }
        let a_transposed = transpose(a);
        let b_transposed = transpose(b);
        for (var k = 0u; k < 4u; k++) {
            adj_tile[(4u * quad + k) * 8u + channels] = a_transposed[k];
            x_tile[(4u * quad + k) * 8u + channels] = b_transposed[k];
        }
        workgroupBarrier();
        for (var p = 0u; p < 32u; p++) {
            let va = adj_tile[p * 8u + lane / 8u];
            let vx = x_tile[p * 8u + lane % 8u];
            sum0 += vx.x * va;
            sum1 += vx.y * va;
            sum2 += vx.z * va;
            sum3 += vx.w * va;
            bias += va;
        }
        workgroupBarrier();
    }
    let part = group.y * params.stride;
    if group.x == 0u {
        // Zero the gap before the bias, as the norm of the gradient includes it.
        for (var k = params.inputs * params.outputs / 4u + lane; k < params.bias; k += 64u) {
            partial[part + k] = vec4f();
        }
    }
    if 4u * out_quad >= params.outputs {
        return;
    }
    if in_quad == 0u {
        partial[part + params.bias + out_quad] = bias;
    }
    // The outputs from 4 out_quad on are a quad of one tile.
    let quads = params.tile / 4u;
    let out = part + out_quad / quads * params.inputs * quads + out_quad % quads;
    let i = 4u * in_quad;
    if i < params.inputs {
        partial[out + i * quads] = sum0;
    }
    if i + 1u < params.inputs {
        partial[out + (i + 1u) * quads] = sum1;
    }
    if i + 2u < params.inputs {
        partial[out + (i + 2u) * quads] = sum2;
    }
    if i + 3u < params.inputs {
        partial[out + (i + 3u) * quads] = sum3;
    }
}
