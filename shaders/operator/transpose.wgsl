// Transposes the weight of a pointwise layer in the tiled order of the kernels.
//
// With this weight, `pointwise` and `block` are their own adjoints with respect to their inputs.
//
// weight: [O / tile, I, tile]
// transposed: [I / tile, O, tile]
//
// One invocation per weight. Workgroups: (O I / 64).
// Adjoint: itself; the weight gradient comes from `pointwise_weight_adj` in the order of the layer.

struct Params {
    outputs: u32, // O
    inputs: u32, // I
    tile: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read_write> transposed: array<f32>;

@compute @workgroup_size(64)
fn transpose(@builtin(global_invocation_id) id: vec3u) {
    let tile = params.tile;
    if id.x >= params.outputs * params.inputs {
        return;
    }
    let of_tile = id.x % (params.outputs * tile);
    let o = of_tile / tile;
    let i = id.x / (params.outputs * tile) * tile + of_tile % tile;
    transposed[id.x] = weight[(o / tile * params.inputs + i) * tile + o % tile];
}
