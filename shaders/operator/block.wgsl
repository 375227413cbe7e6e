// A Fourier block after its columns: y = act(inverse rows of r + S x + bias).
//
// y[s, o, i, j] = act(sum_c skip[o, c] x[s, c, i, j] + sum_k r[s, i, k, o] table[k, j] + bias[o]); k counts the real and
// imaginary parts of the kept columns: table[2 m, j] = f cos(2 pi m j / W), table[2 m + 1, j] = -f sin(2 pi m j / W) with
// f = 1 for column 0 and for the Nyquist column of an even W, else 2. To the sum, the rows of r are more inputs whose
// weights differ from row to row.
// x, y: [S, C, H, Q] quads; skip: [C / tile, C, tile]; bias: [C]; r: [S, H, 2 modes_w, C]; table: [2 modes_w, Q] quads.
// One invocation: one quad and a tile of output channels. Workgroups: (Q, H, S * C / tile) by WIDE x HIGH invocations.
// Adjoint: itself with the `transpose`d skip, no bias and the row transform's table (x), `transform_rows` with this table (r),
// `pointwise_weight_adj` (skip, bias).

struct Params {
    channels: u32, // C
    rows: u32, // H
    row_quads: u32, // Q
    columns: u32, // 2 modes_w
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> skip: array<vec4f>;
@group(0) @binding(2) var<storage, read> bias: array<vec4f>;
@group(0) @binding(3) var<storage, read> table: array<vec4f>;
@group(0) @binding(4) var<storage, read> x: array<vec4f>;
@group(0) @binding(5) var<storage, read> r: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> y: array<vec4f>;

override GELU: bool = true;
override WIDE: u32 = 8;
override HIGH: u32 = 8;

@compute @workgroup_size(WIDE, HIGH)
fn block(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    // Invocations beyond the last quad take part in what a subgroup shares.
    let quad = min(id.x, params.row_quads - 1u);
    let row = min(id.y, params.rows - 1u);
    let tiles = params.channels / $n;
    let sample = group.z / tiles;
    let tile = group.z % tiles;
    let plane = params.rows * params.row_quads;
    let first = sample * params.channels * plane + row * params.row_quads + quad;
    var at = tile * params.channels * $m;
    var y$c = vec4f();
    for (var c = 0u; c < params.channels; c++) {
        let v = x[first + c * plane];
        let w$q = $same(skip, at + $q);
        y$c += w$q.$e * v;
        at += $m;
    }
    at = (sample * params.rows + row) * params.columns * params.channels / 4u + tile * $m;
    for (var k = 0u; k < params.columns; k++) {
        let v = table[k * params.row_quads + quad];
        let w$q = $same(r, at + $q);
        y$c += w$q.$e * v;
        at += params.channels / 4u;
    }
    let out = first + tile * $n * plane;
    let b$q = $same(bias, tile * $m + $q);
    y$c += b$q.$e;
    if id.x >= params.row_quads || id.y >= params.rows {
        return;
    }
    if GELU {
        y[out + $c * plane] = gelu(y$c);
    } else {
        y[out + $c * plane] = y$c;
    }
}
