// GELU of each element: y = gelu(x).
//
// For passes that keep the pre-activation x; otherwise `pointwise` and `block` apply GELU themselves.
//
// x, y: quads
//
// One invocation per quad. Workgroups: (quads / 64 over x and y).
// Adjoint: `gelu_adj`.

struct Params {
    quads: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> y: array<vec4f>;

@compute @workgroup_size(64)
fn activate(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let at = (group.y * groups.x + group.x) * 64u + lane;
    if at >= params.quads {
        return;
    }
    y[at] = gelu(x[at]);
}
