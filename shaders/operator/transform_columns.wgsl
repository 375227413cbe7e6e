// Columns of the truncated real Fourier transform: spectrum[s, m_h, m_w, c] = sum_i r[s, i, m_w, c] table[i, m_h].
//
// table[i, m_h] = exp(-2 pi i k_h i / H) with k_h = m_h - modes_h / 2.
// r: [S, H, modes_w, (re, im), C]; table: [H, tile] complex; spectrum: [S, modes_h, modes_w, C] complex. The tile is modes_h.
// One invocation: one kept column of one channel. Workgroups: (C / 64, modes_w, S).
// Adjoint: `inverse_columns`, with this table conjugated.

struct Params {
    channels: u32, // C
    rows: u32, // H
    modes_w: u32,
    pad: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<vec2f>;
@group(0) @binding(2) var<storage, read> r: array<f32>;
@group(0) @binding(3) var<storage, read_write> spectrum: array<vec2f>;

@compute @workgroup_size(64)
fn transform_columns(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    // Invocations beyond the last channel take part in what a subgroup shares.
    let channel = min(id.x, params.channels - 1u);
    let column = group.y;
    let sample = group.z;
    var z$c = vec2f();
    for (var i = 0u; i < params.rows; i++) {
        let at = ((sample * params.rows + i) * params.modes_w + column) * 2u * params.channels + channel;
        let re = r[at];
        let im = r[at + params.channels];
        let t$c = $same(table, i * $n + $c);
        z$c += vec2f(re * t$c.x - im * t$c.y, re * t$c.y + im * t$c.x);
    }
    if id.x >= params.channels {
        return;
    }
    let out = (sample * $n * params.modes_w + column) * params.channels + channel;
    spectrum[out + $c * params.modes_w * params.channels] = z$c;
}
