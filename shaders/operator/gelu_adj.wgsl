// Adjoint of GELU, in place: adj *= gelu'(x), then x <- gelu(x), which the weight gradient of the next layer
// needs.
//
// x, adj: quads
//
// One invocation per quad. Workgroups: (quads / 64 over x and y).
// Adjoint: none, it is one.

struct Params {
    quads: u32,
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
