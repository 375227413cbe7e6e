// Largest value of each row: rows_max[s, i, c] = max_j x[s, i, c, j].
//
// First half of the scalar head's maximum over all positions. `scalar_head` takes the maximum over the rows.
//
// x: [S, H, C, Q] quads, the last of a row may be padded
// rows_max: [S, H, C]
//
// One invocation per channel of a row. Workgroups: (C / 64, H, S).
// Adjoint: `pool_adj`.

struct Params {
    channels: u32, // C
    rows: u32, // H
    row_quads: u32, // Q
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(2) var<storage, read_write> rows_max: array<f32>;

@compute @workgroup_size(64)
fn pool_rows(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u) {
    let channel = id.x;
    if channel >= params.channels {
        return;
    }
    let row = group.y;
    let sample = group.z;
    let first = ((sample * params.rows + row) * params.channels + channel) * params.row_quads;
    var most = vec4f(x[first]);
    let last = params.row_quads - 1u;
    for (var q = 1u; q < last; q++) {
        most = max(most, vec4f(x[first + q]));
    }
    // Columns of the last quad beyond W repeat the quad's first one, which always exists.
    let v = vec4f(x[first + last]);
    let inside = vec4u(0u, 1u, 2u, 3u) + 4u * last < vec4u(params.columns);
    most = max(most, select(vec4f(v.x), v, inside));
    rows_max[(sample * params.rows + row) * params.channels + channel] =
        max(max(most.x, most.y), max(most.z, most.w));
}
