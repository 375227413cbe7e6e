// Unpacks complex rows into pairs of real ones:
//   x[b, 2 m, j] = scale Re z[b, m, j]
//   x[b, 2 m + 1, j] = scale Im z[b, m, j]
//
// z: [B, ceil(H / 2), W] complex
// x: [B, H, W]
//
// One invocation per element of z. Workgroups: (elements / 64 over x and y, B in z).
// Adjoint: `pack_pairs`.

struct Params {
    rows: u32, // H
    columns: u32, // W
    count: u32, // ceil(H / 2) W
    scale: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> z: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> x: array<f32>;

@compute @workgroup_size(64)
fn unpack_pairs(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let element = (group.y * groups.x + group.x) * 64u + lane;
    if element >= params.count {
        return;
    }
    let row = element / params.columns * 2u;
    let at = (group.z * params.rows + row) * params.columns + element % params.columns;
    let pair = params.scale * z[group.z * params.count + element];
    x[at] = pair.x;
    if row + 1u < params.rows {
        x[at + params.columns] = pair.y;
    }
}
