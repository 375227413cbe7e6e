// Adjoint of `project` towards its input: adj[s, c, p] = weight[c] adj_field[s, p].
//
// weight: [C]; adj_field: [S, H, Q] quads; adj: [S, C, H, Q] quads.
// One invocation: one quad of one channel. Workgroups: (quads / 64, C, S).
// Adjoint: none, it is one.

struct Params {
    channels: u32, // C
    quads: u32, // H Q
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> adj_field: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> adj: array<vec4f>;

@compute @workgroup_size(64)
fn project_adj(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u) {
    let p = id.x;
    if p >= params.quads {
        return;
    }
    let w = weight[group.y];
    adj[(group.z * params.channels + group.y) * params.quads + p] = w * adj_field[group.z * params.quads + p];
}
