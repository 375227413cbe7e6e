// Adjoint of GELU: adj *= gelu'(x), in place; and x becomes gelu(x), which the weights' gradient of the next layer needs.
//
// x, adj: quads. One invocation: one quad. Workgroups: rows of up to 65535, of 64 invocations each.
// Adjoint: none, it is one.

struct Params {
    quads: u32,
    row: u32, // invocations in a row of workgroups
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> x: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> adj: array<vec4f>;

@compute @workgroup_size(64)
fn gelu_adj(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.row + id.x;
    if at >= params.quads {
        return;
    }
    let before = x[at];
    adj[at] *= gelu_slope(before);
    x[at] = gelu(before);
}
