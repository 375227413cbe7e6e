// A Fourier block after its columns: y = act(inverse rows of r + S x + bias).
//
// y[s, o, i, j] = act(sum_c skip[o, c] x[s, c, i, j] + sum_k r[s, i, k, o] table[k, j] + bias[o]); k counts the real and
// imaginary parts of the kept columns: table[2 m, j] = f cos(2 pi m j / W), table[2 m + 1, j] = -f sin(2 pi m j / W) with
// f = 1 for column 0 and for the Nyquist column of an even W, else 2. To the sum, the rows of r are more inputs whose
// weights differ from row to row.
// With ROWS, the rows' spectra of y for the next block, as `transform_rows` makes them: rows[s, i, k, o] = sum_j y[s, o, i, j]
// forward[j, k]; with POOL, its largest values, as `pool_rows` does: rows_max[s, i, o] = max_j y[s, o, i, j]. Either wants a
// whole row in a workgroup, WIDE >= Q. The second tile is the number of columns k that an invocation sums, a divisor of them.
// x, y: [S, C, H, Q] quads; skip: [C / tile, C, tile]; bias: [C]; r, rows: [S, H, 2 modes_w, C]; rows_max: [S, H, C];
// tables: [2 modes_w, Q] quads of table, then [Q, 2 modes_w] quads of forward.
// One invocation: one quad and a tile of output channels. Workgroups: (Q, H, S * C / tile) by WIDE x HIGH invocations.
// Adjoint: itself with the `transpose`d skip, no bias and the row transform's table (x), `transform_rows` with this table (r),
// `pointwise_weight_adj` (skip, bias).

struct Params {
    channels: u32, // C
    rows: u32, // H
    row_quads: u32, // Q
    columns: u32, // 2 modes_w
    width: u32, // W
    pad0: u32,
    pad1: u32,
    pad2: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> skip: array<StoredQuad>;
@group(0) @binding(2) var<storage, read> bias: array<vec4f>;
@group(0) @binding(3) var<storage, read> tables: array<vec4f>;
@group(0) @binding(4) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(5) var<storage, read> r: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> y: array<StoredQuad>;
@group(0) @binding(7) var<storage, read_write> rows: array<f32>;
@group(0) @binding(8) var<storage, read_write> rows_max: array<f32>;

override GELU: bool = true;
override ROWS: bool = false;
override POOL: bool = false;
override WIDE: u32 = 8;
override HIGH: u32 = 8;
// Quads of the workgroup's memory: HIGH * tile * (Q | 1) with ROWS or POOL.
override HELD: u32 = 1;

// The workgroup's part of y, [HIGH, tile, Q]; an odd number of quads to a row spreads equal places over the banks.
var<workgroup> held: array<vec4f, HELD>;

@compute @workgroup_size(WIDE, HIGH)
fn block(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(workgroup_id) group: vec3u$lane
) {
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
        let v = vec4f(x[first + c * plane]);
        let w$q = $same(vec4f(skip[at + $q]));
        y$c += w$q.$e * v;
        at += $m;
    }
    at = (sample * params.rows + row) * params.columns * params.channels / 4u + tile * $m;
    for (var k = 0u; k < params.columns; k++) {
        let v = tables[k * params.row_quads + quad];
        let w$q = $same(r[at + $q]);
        y$c += w$q.$e * v;
        at += params.channels / 4u;
    }
    let out = first + tile * $n * plane;
    let b$q = $same(bias[tile * $m + $q]);
    y$c += b$q.$e;
    if GELU {
        y$c = gelu(y$c);
    }
    if id.x < params.row_quads && id.y < params.rows {
        y[out + $c * plane] = StoredQuad(y$c);
    }
    if !ROWS && !POOL {
        return;
    }
    let stride = params.row_quads | 1u;
    if id.x < params.row_quads {
        held[(local.y * $n + $c) * stride + id.x] = y$c;
    }
    workgroupBarrier();
    // A part is some columns k of one channel of one row. Invocations beyond the last one take part in what a subgroup shares.
    let parts = HIGH * $n * (params.columns / $t);
    let forward = params.columns * params.row_quads;
    for (var begin = 0u; begin < parts; begin += WIDE * HIGH) {
        let own = begin + local.y * WIDE + local.x;
        let part = min(own, parts - 1u);
        let channel = part % $n;
        let line = part / $n % HIGH;
        let column = part / ($n * HIGH) * $t;
        let at_row = (line * $n + channel) * stride;
        let i = group.y * HIGH + line;
        let exists = own < parts && i < params.rows;
        let out_row = sample * params.rows + i;
        let out_channel = tile * $n + channel;
        if ROWS {
            var z$k = 0.0;
            for (var q = 0u; q < params.row_quads; q++) {
                let v = held[at_row + q];
                let t$k = $same(tables[forward + q * params.columns + column + $k]);
                z$k += dot(v, t$k);
            }
            if exists {
                let first_out = (out_row * params.columns + column) * params.channels + out_channel;
                rows[first_out + $k * params.channels] = z$k;
            }
        }
        if POOL && column == 0u {
            var most = held[at_row];
            let last = params.row_quads - 1u;
            for (var q = 1u; q < last; q++) {
                most = max(most, held[at_row + q]);
            }
            // Columns of the last quad beyond W repeat its first one, which always exists.
            let v = held[at_row + last];
            let inside = vec4u(0u, 1u, 2u, 3u) + 4u * last < vec4u(params.width);
            most = max(most, select(vec4f(v.x), v, inside));
            if exists {
                rows_max[out_row * params.channels + out_channel] = max(max(most.x, most.y), max(most.z, most.w));
            }
        }
    }
}
