// Conjugate transpose of the weight of `spectral`: transposed[m, o, i] = conj(weight[m, i, o]).
//
// `spectral` with this weight is the adjoint of `spectral` with respect to its input.
//
// weight: [M, I / 2, O, 2] complex, in the order of `spectral`
// transposed: [M, O / 2, I, 2] complex
//
// One invocation per weight. Workgroups: (I / 64, O, M).
// Adjoint: itself; the weight gradient comes from `spectral_weight_adj`.

struct Params {
    inputs: u32, // I
    outputs: u32, // O
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> transposed: array<vec2f>;

@compute @workgroup_size(64)
fn spectral_transpose(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if i >= params.inputs {
        return;
    }
    let o = id.y;
    let matrix = id.z * params.inputs * params.outputs;
    let w = weight[matrix + (i / 2u * params.outputs + o) * 2u + i % 2u];
    transposed[matrix + (o / 2u * params.inputs + i) * 2u + o % 2u] = vec2f(w.x, -w.y);
}
