// Columns of the inverse truncated transform: r[s, i, m_w, c] = sum_m_h spectrum[s, m_h, m_w, c] table[i, m_h].
//
// table[i, m_h] = exp(+2 pi i k_h i / H). The rows follow inside `block`, which drops the imaginary part of column 0:
// what an inverse real transform does with the non-Hermitian part of that column.
// spectrum: [S, modes_h, modes_w, C] complex; table: [H, tile] complex; r: [S, H, modes_w, (re, im), C]. The tile is modes_h.
// One invocation: a strip of rows of one kept column of one channel. Workgroups: (C / 64, modes_w * strips, S).
// Adjoint: `transform_columns`, with this table conjugated.

struct Params {
    channels: u32, // C
    rows: u32, // H
    modes_w: u32,
    strip: u32, // rows per invocation
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<vec2f>;
@group(0) @binding(2) var<storage, read> spectrum: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> r: array<f32>;

@compute @workgroup_size(64)
fn inverse_columns(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    // Invocations beyond the last channel take part in what a subgroup shares.
    let channel = min(id.x, params.channels - 1u);
    let column = group.y % params.modes_w;
    let first = group.y / params.modes_w * params.strip;
    let sample = group.z;
    let first_mode = (sample * $n * params.modes_w + column) * params.channels + channel;
    let z$c = spectrum[first_mode + $c * params.modes_w * params.channels];
    let end = min(first + params.strip, params.rows);
    for (var i = first; i < end; i++) {
        var re = 0.0;
        var im = 0.0;
        let t$c = $same(table, i * $n + $c);
        re += z$c.x * t$c.x - z$c.y * t$c.y;
        im += z$c.x * t$c.y + z$c.y * t$c.x;
        let at = ((sample * params.rows + i) * params.modes_w + column) * 2u * params.channels + channel;
        if id.x < params.channels {
            r[at] = re;
            r[at + params.channels] = im;
        }
    }
}
