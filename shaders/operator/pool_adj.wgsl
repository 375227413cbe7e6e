// Adjoint of the scalar head and its maximum: adj[s, i, c, j] += weight[c] adj_scalar[s] at the first
// position (i, j), row by row, where x[s, i, c, j] is largest.
//
// Also sets pooled[s, c] to that largest value, which the weight gradient needs.
//
// weight: [C]
// adj_scalar: [S]
// rows_max: [S, H, C] (`pool_rows`)
// x, adj: [S, H, C, W'] with padded rows
// pooled: [S, C]
//
// One invocation per channel of a sample. Workgroups: (C / 64, S).
// Adjoint: none, it is one.

struct Params {
    channels: u32, // C
    rows: u32, // H
    stride: u32, // W'
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> adj_scalar: array<f32>;
@group(0) @binding(3) var<storage, read> rows_max: array<f32>;
@group(0) @binding(4) var<storage, read> x: array<f32>;
@group(0) @binding(5) var<storage, read_write> adj: array<f32>;
@group(0) @binding(6) var<storage, read_write> pooled: array<f32>;

@compute @workgroup_size(64)
fn pool_adj(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u) {
    let channel = id.x;
    if channel >= params.channels {
        return;
    }
    let sample = group.y;
    var row = 0u;
    var most = rows_max[sample * params.rows * params.channels + channel];
    for (var i = 1u; i < params.rows; i++) {
        let other = rows_max[(sample * params.rows + i) * params.channels + channel];
        if other > most {
            most = other;
            row = i;
        }
    }
    let first = ((sample * params.rows + row) * params.channels + channel) * params.stride;
    // The last column needs no comparison: it is the largest if none before it is.
    var column = 0u;
    while column + 1u < params.columns && x[first + column] < most {
        column++;
    }
    adj[first + column] += weight[channel] * adj_scalar[sample];
    pooled[sample * params.channels + channel] = most;
}
