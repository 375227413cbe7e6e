// A layer of the network over rows: a Fourier block after its columns, or the lifting.
//
// Block: y[s, i, o, j] = act(sum_c skip[o, c] x[s, i, c, j] + sum_k r[s, i, k, o] table[k, j] + bias[o]); k counts the real and
// imaginary parts of the kept columns: table[2 m, j] = f cos(2 pi m j / W), table[2 m + 1, j] = -f sin(2 pi m j / W) with
// f = 1 for column 0 and for the Nyquist column of an even W, else 2. To the sum, the rows of r are more inputs whose
// weights differ from row to row.
// Lifting: y[s, i, o, j] = act(sum_u skip[o, u] gelu(sum_e r[u, e] x[s, i, e, j] + r[u, E]) + bias[o]): the hidden units u are the
// inputs, made on the way from the E channels of x, or of what they are embedded from. Which of these it is, and what it binds
// beside what is told here, is told by the pieces that are appended (`shaders/pieces`: block_inputs; or lifting_inputs, and
// lifted_embedding or lifted_fields).
// With ROWS, the rows' spectra of y for the next block, as `transform_rows` makes them: made[s, i, k, o] = sum_j y[s, i, o, j]
// forward[j, k]; with POOL, its largest values, as `pool_rows` does: rows_max[s, i, o] = max_j y[s, i, o, j]. Either wants a
// whole row in a workgroup, WIDE >= Q. With FIELD, instead of y the last layer of the field head, as `project` makes it, in parts to
// be added up: made[part, s, i, j] = sum_o head[o] y[s, i, o, j] over the channels of a workgroup; the first has the head's bias.
//
// x: [S, H, C or E, Q] quads; y: [S, H, C, Q] quads; skip: [C / tile, inputs, tile]; bias: [C], then with FIELD head: [C] and its
// bias; r: [S, H, 2 modes_w, C], or [inputs, (E + 1) in quads]; made: [S, H, 2 modes_w, C], or [parts, S, H, Q] quads;
// rows_max: [S, H, C]; tables: [2 modes_w, Q] quads of table, then [Q, 2 modes_w] quads of forward; of the lifting, forward alone.
// The second tile is the number of columns k of `made` that an invocation sums, a divisor of them.
// One invocation: one quad and a tile of output channels. With STAGED, inputs and weights go through workgroup memory, CHUNK inputs
// at a time: each is read once for all of the workgroup, and in parallel; a workgroup then is of one row (HIGH = 1).
// Workgroups: (Q, H, S * C / tile) by WIDE x HIGH x DEEP invocations, those of a row side by side.
// Adjoint: itself with the `transpose`d skip, no bias and the row transform's table (x), `transform_rows` with this table (r),
// `pointwise_weight_adj` (skip, bias). The lifting has none in this form: training takes its layers one by one.

struct Params {
    inputs: u32, // C, or the hidden units of the lifting
    channels: u32, // C
    rows: u32, // H
    row_quads: u32, // Q
    columns: u32, // 2 modes_w
    width: u32, // W
    samples: u32, // S
    embedded: u32, // E
    all_samples: u32, // of the fields, of which `first` is the first of S; this and the rest are for `shaders/pieces/features.wgsl`
    pad0: u32,
    pad1: u32,
    pad2: u32,
    first: u32,
    hidden: u32,
    parts: u32,
    first_sum: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> skip: array<StoredQuad>;
@group(0) @binding(2) var<storage, read> bias: array<vec4f>;
@group(0) @binding(3) var<storage, read> tables: array<vec4f>;
@group(0) @binding(4) var<storage, read> r: array<vec4f>;

override GELU: bool = true;
override ROWS: bool = false;
override POOL: bool = false;
override FIELD: bool = false;
override STAGED: bool = false;
override WIDE: u32 = 8;
override HIGH: u32 = 8;
override DEEP: u32 = 1;
override CHUNK: u32 = 1;
// Quads of the workgroup's memory: the largest of what the kinds of work want, see there.
override MEMORY: u32 = 1;

var<workgroup> memory: array<vec4f, MEMORY>;

// Subgroups want workgroups of one dimension.
@compute @workgroup_size(WIDE * HIGH * DEEP)
fn block(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3u$lane) {
    let local = vec3u(index % WIDE, index / WIDE % HIGH, index / (WIDE * HIGH));
    let id = group * vec3u(WIDE, HIGH, DEEP) + local;
    // Invocations beyond the last quad take part in what a subgroup shares.
    let quad = min(id.x, params.row_quads - 1u);
    let row = min(id.y, params.rows - 1u);
    let tiles = params.channels / $n;
    let sample = id.z / tiles;
    let tile = id.z % tiles;
    let columns = select(params.columns, 0u, LIFTING);
    let line = sample * params.rows + row;
    var y$c = vec4f();
    if STAGED {
        // Inputs [CHUNK, WIDE], then their weights [CHUNK, DEEP, tile].
        let all = params.inputs + columns;
        let first_tile = tile - local.z;
        prepare(sample, row, group.x * WIDE, index);
        for (var begin = 0u; begin < all; begin += CHUNK) {
            workgroupBarrier();
            for (var k = index; k < CHUNK * WIDE; k += WIDE * DEEP) {
                let i = begin + k / WIDE;
                let q = min(group.x * WIDE + k % WIDE, params.row_quads - 1u);
                var v = vec4f();
                if i < params.inputs {
                    v = input(sample, i, row, q);
                } else if i < all {
                    v = tables[(i - params.inputs) * params.row_quads + q];
                }
                memory[k] = v;
            }
            for (var k = index; k < CHUNK * DEEP * $m; k += WIDE * DEEP) {
                let i = begin + k / (DEEP * $m);
                let q = k % (DEEP * $m);
                var w = vec4f();
                if i < params.inputs {
                    w = vec4f(skip[((first_tile + q / $m) * params.inputs + i) * $m + q % $m]);
                } else if i < all {
                    w = r[(line * columns + i - params.inputs) * params.channels / 4u + first_tile * $m + q];
                }
                memory[CHUNK * WIDE + k] = w;
            }
            workgroupBarrier();
            for (var i = 0u; i < CHUNK; i++) {
                let v = memory[i * WIDE + local.x];
                let w$q = memory[CHUNK * WIDE + (i * DEEP + local.z) * $m + $q];
                y$c += w$q.$e * v;
            }
        }
        workgroupBarrier();
    } else {
        var at = tile * params.inputs * $m;
        for (var i = 0u; i < params.inputs; i++) {
            let v = input(sample, i, row, quad);
            let w$q = $same(vec4f(skip[at + $q]));
            y$c += w$q.$e * v;
            at += $m;
        }
        at = line * columns * params.channels / 4u + tile * $m;
        for (var k = 0u; k < columns; k++) {
            let v = tables[k * params.row_quads + quad];
            let w$q = $same(r[at + $q]);
            y$c += w$q.$e * v;
            at += params.channels / 4u;
        }
    }
    let b$q = $same(bias[tile * $m + $q]);
    y$c += b$q.$e;
    if GELU {
        y$c = gelu(y$c);
    }
    let exists = id.x < params.row_quads && id.y < params.rows;
    if FIELD {
        var sum = vec4f();
        let h$q = $same(bias[params.channels / 4u + tile * $m + $q]);
        sum += h$q.$e * y$c;
        // [DEEP, HIGH, WIDE]: the first invocation of a quad adds up.
        memory[index] = sum;
        workgroupBarrier();
        if local.z == 0u {
            for (var other = 1u; other < DEEP; other++) {
                sum += memory[index + other * WIDE * HIGH];
            }
        }
        let part = tile / DEEP;
        if part == 0u {
            sum += bias[params.channels / 2u].x;
        }
        if exists && local.z == 0u {
            let out = 4u * ((part * params.samples * params.rows + line) * params.row_quads + quad);
            made[out] = sum.x;
            made[out + 1u] = sum.y;
            made[out + 2u] = sum.z;
            made[out + 3u] = sum.w;
        }
        return;
    }
    let out = (line * params.channels + tile * $n) * params.row_quads + quad;
    if exists {
        y[out + $c * params.row_quads] = StoredQuad(y$c);
    }
    if !ROWS && !POOL {
        return;
    }
    // The workgroup's part of y, [HIGH, DEEP, tile, Q]; an odd number of quads to a row spreads equal places over the banks.
    let stride = params.row_quads | 1u;
    if id.x < params.row_quads {
        memory[((local.y * DEEP + local.z) * $n + $c) * stride + id.x] = y$c;
    }
    workgroupBarrier();
    // A part is some columns k of one channel of one row. Invocations beyond the last one take part in what a subgroup shares.
    let parts = HIGH * DEEP * $n * (params.columns / $t);
    let forward = columns * params.row_quads;
    for (var begin = 0u; begin < parts; begin += WIDE * HIGH * DEEP) {
        let part = min(begin + index, parts - 1u);
        let of_row = part % (DEEP * $n);
        let in_group = part / (DEEP * $n) % HIGH;
        let column = part / (DEEP * $n * HIGH) * $t;
        let at_row = (in_group * DEEP * $n + of_row) * stride;
        let i = group.y * HIGH + in_group;
        let wanted = begin + index < parts && i < params.rows;
        let out_row = sample * params.rows + i;
        let channel = (tile - local.z) * $n + of_row;
        if ROWS {
            var z$k = 0.0;
            for (var q = 0u; q < params.row_quads; q++) {
                let v = memory[at_row + q];
                let t$k = $same(tables[forward + q * params.columns + column + $k]);
                z$k += dot(v, t$k);
            }
            if wanted {
                let first_out = (out_row * params.columns + column) * params.channels + channel;
                made[first_out + $k * params.channels] = z$k;
            }
        }
        if POOL && column == 0u {
            var most = memory[at_row];
            let last = params.row_quads - 1u;
            for (var q = 1u; q < last; q++) {
                most = max(most, memory[at_row + q]);
            }
            // Columns of the last quad beyond W repeat its first one, which always exists.
            let v = memory[at_row + last];
            let inside = vec4u(0u, 1u, 2u, 3u) + 4u * last < vec4u(params.width);
            most = max(most, select(vec4f(v.x), v, inside));
            if wanted {
                keep_largest(out_row * params.channels + channel, max(max(most.x, most.y), max(most.z, most.w)));
            }
        }
    }
}
