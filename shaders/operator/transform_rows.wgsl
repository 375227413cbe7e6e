// Truncated real Fourier transform of the rows: r[s, i, k, c] = sum_j x[s, i, c, j] table[j, k].
//
// k counts the real and imaginary parts of the kept columns, Re 0, Im 0, Re 1, ...:
//   table[j, 2 m] = cos(2 pi m j / W) / (H W)
//   table[j, 2 m + 1] = -sin(2 pi m j / W) / (H W)
// The table is zero in the padding, so that padded columns do not count.
//
// table: [Q, tile] quads, tile = 2 modes_w
// x: [S, H, C, Q] quads
// r: [S, H, tile, C]
//
// One invocation per channel of a row. Workgroups: (C / 64, H, S).
// Adjoint: the inverse rows of `block`, with this table.

struct Params {
    channels: u32, // C
    rows: u32, // H
    row_quads: u32, // Q
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<vec4f>;
@group(0) @binding(2) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(3) var<storage, read_write> r: array<f32>;

@compute @workgroup_size(64)
fn transform_rows(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    // Invocations beyond the last channel still take part in subgroup broadcasts.
    let channel = min(id.x, params.channels - 1u);
    let row = group.y;
    let sample = group.z;
    let first = ((sample * params.rows + row) * params.channels + channel) * params.row_quads;
    var r$c = 0.0;
    for (var q = 0u; q < params.row_quads; q++) {
        let v = vec4f(x[first + q]);
        let t$c = $same(table[q * $n + $c]);
        r$c += dot(v, t$c);
    }
    if id.x >= params.channels {
        return;
    }
    let out = (sample * params.rows + row) * $n * params.channels + channel;
    r[out + $c * params.channels] = r$c;
}
