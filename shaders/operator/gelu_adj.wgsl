// Adjoint of GELU: adj *= gelu'(x), in place; and x becomes gelu(x), which the weights' gradient of the next layer needs.
//
// x, adj: quads. One invocation: one quad. Workgroups: (quads / 64 along x, then y).
// Adjoint: none, it is one.

struct Params {
    quads: u32,
    pad0: u32,
    pad1: u32,
    pad2: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> x: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> adj: array<vec4f>;

@compute @workgroup_size(64)
fn gelu_adj(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let at = (group.y * groups.x + group.x) * 64u + lane;
    if at >= params.quads {
        return;
    }
    let before = x[at];
    adj[at] *= gelu_slope(before);
    x[at] = gelu(before);
}
