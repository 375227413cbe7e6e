// Adjoint of `project` with respect to x: adj[l, c, j] = weight[c] adj_field[l, j] at position j of line l.
//
// weight: [C]
// adj_field: [S, H, Q] quads
// adj: [S, H, C, Q] quads
//
// One invocation per quad of a channel. Workgroups: (quads / 64 over x and y, C in z).
// Adjoint: none, it is one.

struct Params {
    channels: u32, // C
    quads: u32, // S H Q
    row_quads: u32, // Q
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> adj_field: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> adj: array<vec4f>;

@compute @workgroup_size(64)
fn project_adj(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.quads {
        return;
    }
    let channel = group.z;
    let line = p / params.row_quads;
    adj[(line * params.channels + channel) * params.row_quads + p % params.row_quads] = weight[channel] * adj_field[p];
}
