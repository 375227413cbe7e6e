// A pointwise layer: y[l, o, j] = act(sum_i weight[o, i] x[l, i, j] + bias[o]) at position j of line l.
//
// weight: [O / tile, I, tile]
// bias: [O]
// x: [lines, I, Q] quads
// y: [lines, O, Q] quads
//
// One invocation per quad and tile of output channels, held in named registers. All invocations of a
// workgroup read the same weights.
// Workgroups: (O / tile, quads / WORKGROUP over y and z), so that those that run at about the same time read the
// same part of x.
// Adjoint: itself with the `transpose`d weight and no bias (x), `pointwise_weight_adj` (weight, bias).

struct Params {
    inputs: u32, // I
    outputs: u32, // O
    quads: u32, // per channel, in all lines of the dispatch
    row_quads: u32, // Q
    x_first: u32, // first line of x
    y_first: u32, // first line of y
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<StoredQuad>;
@group(0) @binding(2) var<storage, read> bias: array<vec4f>;
@group(0) @binding(3) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(4) var<storage, read_write> y: array<StoredQuad>;

override GELU: bool = true;
override WORKGROUP: u32 = 64;

@compute @workgroup_size(WORKGROUP)
fn pointwise(
    @builtin(local_invocation_index) index: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u$lane
) {
    let all = (group.z * groups.y + group.y) * WORKGROUP + index;
    // Invocations beyond the last quad still take part in subgroup broadcasts.
    let p = min(all, params.quads - 1u);
    let line = p / params.row_quads;
    let quad = p % params.row_quads;
    let tile = group.x;
    let first = (params.x_first + line) * params.inputs * params.row_quads + quad;
    var at = tile * params.inputs * $m;
    var y$c = vec4f();
    for (var i = 0u; i < params.inputs; i++) {
        let v = vec4f(x[first + i * params.row_quads]);
        let w$q = $same(vec4f(weight[at + $q]));
        y$c += w$q.$e * v;
        at += $m;
    }
    let out = ((params.y_first + line) * params.outputs + tile * $n) * params.row_quads + quad;
    let b$q = $same(bias[tile * $m + $q]);
    y$c += b$q.$e;
    if all >= params.quads {
        return;
    }
    if GELU {
        y[out + $c * params.row_quads] = StoredQuad(gelu(y$c));
    } else {
        y[out + $c * params.row_quads] = StoredQuad(y$c);
    }
}
