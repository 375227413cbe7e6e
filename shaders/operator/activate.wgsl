// GELU of each element: y = gelu(x).
//
// What `pointwise` and `block` do by themselves, for passes that keep what comes before it. x, y: quads.
// One invocation: one quad. Workgroups: rows of up to 65535, of 64 invocations each.
// Adjoint: `gelu_adj`.

struct Params {
    quads: u32,
    row: u32, // invocations in a row of workgroups
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> y: array<vec4f>;

@compute @workgroup_size(64)
fn activate(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.row + id.x;
    if at >= params.quads {
        return;
    }
    y[at] = gelu(x[at]);
}
