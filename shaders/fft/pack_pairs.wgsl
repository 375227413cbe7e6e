// Packs two real rows into one complex row, with 0 for a row beyond the last:
//   z[b, m, j] = scale (x[b, 2 m, j] + i x[b, 2 m + 1, j])
//
// One complex transform then serves two rows of any length, and `split_spectra` separates their spectra. Rows
// of different items of a batch are never paired.
//
// x: [B, H, W]
// z: [B, ceil(H / 2), W] complex
//
// One invocation per element of z. Workgroups: (elements / 64 over x and y, B in z).
// Adjoint: `unpack_pairs`.

struct Params {
    rows: u32, // H
    columns: u32, // W
    count: u32, // ceil(H / 2) W
    scale: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> z: array<vec2f>;

@compute @workgroup_size(64)
fn pack_pairs(
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
    var second = 0.0;
    if row + 1u < params.rows {
        second = x[at + params.columns];
    }
    z[group.z * params.count + element] = params.scale * vec2f(x[at], second);
}
