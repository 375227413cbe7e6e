// A pointwise layer: y[s, o, p] = act(sum_i weight[o, i] x[s, i, p] + bias[o]).
//
// x: [S, I, H, Q] quads of 4 columns; weight: [O / tile, I, tile]; bias: [O]; y: [S, O, H, Q] quads.
// One invocation: one quad and a tile of output channels, held in named registers; the weights' addresses are the
// same for a whole workgroup. Workgroups: (quads, O / tile, S).
// Adjoint: itself with the `transpose`d weight and no bias (x), `pointwise_weight_adj` (weight, bias).

struct Params {
    inputs: u32, // I
    outputs: u32, // O
    quads: u32, // of a plane, that are taken
    x_plane: u32, // quads of a plane of x
    y_plane: u32, // quads of a plane of y
    x_first: u32, // first quad of x that is taken
    y_first: u32, // where it goes in y
    pad: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<StoredQuad>;
@group(0) @binding(2) var<storage, read> bias: array<vec4f>;
@group(0) @binding(3) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(4) var<storage, read_write> y: array<StoredQuad>;

override GELU: bool = true;
override WORKGROUP: u32 = 64;

@compute @workgroup_size(WORKGROUP)
fn pointwise(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    // Invocations beyond the last quad take part in what a subgroup shares.
    let p = min(id.x, params.quads - 1u);
    let tile = group.y;
    let first = params.x_first + group.z * params.inputs * params.x_plane + p;
    var at = tile * params.inputs * $m;
    var y$c = vec4f();
    for (var i = 0u; i < params.inputs; i++) {
        let v = vec4f(x[first + i * params.x_plane]);
        let w$q = $same(vec4f(weight[at + $q]));
        y$c += w$q.$e * v;
        at += $m;
    }
    let out = params.y_first + (group.z * params.outputs + tile * $n) * params.y_plane + p;
    let b$q = $same(bias[tile * $m + $q]);
    y$c += b$q.$e;
    if id.x >= params.quads {
        return;
    }
    if GELU {
        y[out + $c * params.y_plane] = StoredQuad(gelu(y$c));
    } else {
        y[out + $c * params.y_plane] = StoredQuad(y$c);
    }
}
