// A layer of the network over rows: a Fourier block after its column transforms, or the lifting.
//
// Block:
//   y[s, i, o, j] = act(sum_c skip[o, c] x[s, i, c, j] + sum_k r[s, i, k, o] table[k, j] + bias[o])
//   table[2 m, j] = f cos(2 pi m j / W), table[2 m + 1, j] = -f sin(2 pi m j / W)
// k counts the real and imaginary parts of the kept columns; f = 1 for column 0 and for the Nyquist column of
// an even W, else 2. In the sum, each table[k] is a further input, whose weight r differs from row to row.
// Lifting:
//   y[s, i, o, j] = act(sum_u skip[o, u] gelu(sum_e r[u, e] x[s, i, e, j] + r[u, E]) + bias[o])
// The inputs are the hidden units u, computed on the fly from the E channels of x, which may be embedded on
// the fly as well.
// The appended pieces (`shaders/pieces`) select the layer and add its bindings: block_inputs, or
// lifting_inputs with lifted_embedding or lifted_fields.
//
// Epilogues:
//   ROWS: rows_or_field[s, i, k, o] = sum_j y[s, i, o, j] forward[j, k], for the next block
//   POOL: rows_max[s, i, o] = max_j y[s, i, o, j]
//   FIELD: rows_or_field[part, s, i, j] = sum_o head[o] y[s, i, o, j] over the channels of a workgroup
// ROWS does what `transform_rows` does, and POOL what `pool_rows` does. Both need a whole row in a workgroup,
// WIDE * SPAN >= Q. Where operands are broadcast, because loads are expensive, lanes exchange their sums and
// maxima; otherwise all of y passes through workgroup memory. FIELD is the last layer of the field head, as in
// `project`, in parts to be summed, of which the first includes the bias of the head. It replaces y, which is
// not written.
//
// skip: [C / tile, inputs, tile]
// bias: [C]; with FIELD followed by head [C] and its bias
// tables: [2 modes_w, Q] quads of table (not for the lifting), then [Q, 2 modes_w] quads of forward
// r: [S, H, 2 modes_w, C]; for the lifting [inputs, E + 1 rounded up to quads]
// x: [S, H, C, Q] quads; for the lifting [S, H, E, Q] quads, or the fields it embeds
// y: [S, H, C, Q] quads
// rows_or_field: [S, H, 2 modes_w, C] with ROWS, [parts, S, H, Q] quads with FIELD
// rows_max: [S, H, C]
//
// One invocation per tile of output channels and SPAN quads, WIDE apart, of each of LINES rows. With STAGED, inputs
// and weights pass through workgroup memory, CHUNK inputs at a time, so that a workgroup reads each of them once and
// in parallel; only then, and in a block, there may be several rows. The second tile is the number of columns k of
// `rows_or_field` that an invocation sums for a quad of channels from workgroup memory. It divides their number,
// 2 modes_w.
// Workgroups: (Q / (SPAN * WIDE), H / LINES, S * C / (tile * DEEP)) of DEEP rows of WIDE consecutive invocations. Each of
// these has one tile of output channels.
// Adjoint: itself with the `transpose`d skip, no bias and the table of the row transform (x),
// `transform_rows` with this table (r), `pointwise_weight_adj` (skip, bias). The lifting has none in this
// form, because training runs its layers one by one.

struct Params {
    inputs: u32, // C, or the hidden units of the lifting
    channels: u32, // C
    rows: u32, // H
    row_quads: u32, // Q
    columns: u32, // 2 modes_w
    width: u32, // W
    samples: u32, // S
    embedded: u32, // E
    all_samples: u32, // samples of the fields, S of them from `first` on; this and all below serve `features`
    first: u32,
    hidden: u32,
    parts: u32,
    first_sum: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<$space0> skip: array<StoredQuad$length0>;
@group(0) @binding(2) var<storage, read> bias: array<vec4f>;
@group(0) @binding(3) var<$space1> tables: array<vec4f$length1>;
@group(0) @binding(4) var<storage, read> r: array<vec4f>;

override GELU: bool = true;
override ROWS: bool = false;
override POOL: bool = false;
override FIELD: bool = false;
override STAGED: bool = false;
override WIDE: u32 = 8;
override SPAN: u32 = 1;
override LINES: u32 = 1;
override DEEP: u32 = 1;
override CHUNK: u32 = 1;
// Quads of workgroup memory, as many as the most demanding of its uses below needs.
override MEMORY: u32 = 1;

var<workgroup> memory: array<vec4f, MEMORY>;

// One-dimensional, as subgroup operations require.
@compute @workgroup_size(WIDE * DEEP)
fn block(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3u$lane) {
    let depth = index / WIDE;
    let row = group.y * LINES;
    let tiles = params.channels / $n;
    let sample = group.z * DEEP / tiles;
    let first_tile = group.z * DEEP % tiles;
    let tile = first_tile + depth;
    let columns = select(params.columns, 0u, LIFTING);
    let last_row = params.rows - 1u;
    let line = sample * params.rows + row;
    let first_quad = group.x * WIDE * SPAN;
    // The positions of an invocation: SPAN of each row.
    let positions = LINES * SPAN;
    let place$x = first_quad + $xu % SPAN * WIDE + index % WIDE;
    let exists$x = place$x < params.row_quads && row + $xu / SPAN <= last_row;
    // Invocations beyond the last quad still take part in subgroup broadcasts.
    let quad$x = min(place$x, params.row_quads - 1u);
    let line$x = sample * params.rows + min(row + $xu / SPAN, last_row);
    var y$c = vec4f();
    prepare(sample, row, first_quad, index);
    if STAGED {
        // Memory holds the inputs [CHUNK, LINES, SPAN, WIDE], then their weights [CHUNK, DEEP, tile], or those of columns
        // [CHUNK, LINES, DEEP, tile], in quads.
        let all = params.inputs + columns;
        let inputs = CHUNK * positions * WIDE;
        for (var begin = 0u; begin < all;) {
            // A chunk consists of inputs or of columns. The table is the same for all rows, but is staged for each: so both
            // are read alike.
            let of_columns = begin >= params.inputs;
            let count = min(CHUNK, select(params.inputs, all, of_columns) - begin);
            workgroupBarrier();
            // Four at a time, whose loads are all under way before the first is awaited. Beyond the last one
            // it is loaded again.
            for (var first = 0u; first < count * positions; first += 4u * DEEP) {
                let k$4 = first + $4 * DEEP + depth;
                let i$4 = begin + min(k$4 / positions, count - 1u);
                let q$4 = min(first_quad + k$4 % SPAN * WIDE + index % WIDE, params.row_quads - 1u);
                let l$4 = min(row + k$4 % positions / SPAN, last_row);
                var v$4 = vec4f();
                if LIFTING {
                    let quads = params.embedded / 4u + 1u;
                    for (var part = 0u; part < quads; part++) {
                        let h$4 = r[i$4 * quads + part];
                        for (var e = 0u; e < 4u; e++) {
                            if 4u * part + e < params.embedded {
                                v$4 += h$4[e] * channel(sample, 4u * part + e, l$4, q$4);
                            } else if 4u * part + e == params.embedded {
                                v$4 += h$4[e];
                            }
                        }
                    }
                    v$4 = gelu(v$4);
                } else if of_columns {
                    v$4 = tables[(i$4 - params.inputs) * params.row_quads + q$4];
                } else {
                    v$4 = input(sample, i$4, l$4, q$4);
                }
                if k$4 < count * positions { memory[k$4 * WIDE + index % WIDE] = v$4; }
            }
            let weights = DEEP * $m;
            let each = select(weights, LINES * weights, of_columns);
            for (var first = 0u; first < count * each; first += 4u * WIDE * DEEP) {
                let k$4 = first + $4 * WIDE * DEEP + index;
                let i$4 = begin + min(k$4 / each, count - 1u);
                let q$4 = k$4 % weights;
                var w$4 = vec4f();
                if of_columns {
                    let l$4 = sample * params.rows + min(row + k$4 % each / weights, last_row);
                    w$4 = r[(l$4 * columns + i$4 - params.inputs) * params.channels / 4u + first_tile * $m + q$4];
                } else {
                    w$4 = vec4f(skip[((first_tile + q$4 / $m) * params.inputs + i$4) * $m + q$4 % $m]);
                }
                if k$4 < count * each { memory[inputs + k$4] = w$4; }
            }
            workgroupBarrier();
            if LINES > 1u && of_columns {
                for (var i = 0u; i < count; i++) {
                    let v$x = memory[(i * positions + $xu) * WIDE + index % WIDE];
                    let w$q_$x = memory[inputs + ((i * LINES + $xu / SPAN) * DEEP + depth) * $m + $q];
                    y$c += w$q_$x.$e * v$x;
                }
            } else {
                for (var i = 0u; i < count; i++) {
                    let v$x = memory[(i * positions + $xu) * WIDE + index % WIDE];
                    let w$q = memory[inputs + (i * DEEP + depth) * $m + $q];
                    y$c += w$q.$e * v$x;
                }
            }
            begin += count;
        }
        workgroupBarrier();
    } else {
        // Several inputs at a time: sums that do not fit in registers are loaded and stored once for all of
        // them.
        var embedded$x = mat4x4f();
        var last$x = vec4f();
        if LIFTING {
            embedded$x = mat4x4f(channel(sample, 0u, row, quad$x), channel(sample, 1u, row, quad$x), channel(sample, 2u, row, quad$x), channel(sample, 3u, row, quad$x));
            last$x = channel(sample, 4u, row, quad$x);
        }
        var at = tile * params.inputs * $m;
        for (var i = 0u; i < params.inputs; i += 4u) {
            var va$x = vec4f();
            var vb$x = vec4f();
            var vc$x = vec4f();
            var vd$x = vec4f();
            if LIFTING {
                let h$8 = $same(r[2u * i + $8]);
                va$x = gelu(embedded$x * h0 + last$x * h1.x + h1.y);
                vb$x = gelu(embedded$x * h2 + last$x * h3.x + h3.y);
                vc$x = gelu(embedded$x * h4 + last$x * h5.x + h5.y);
                vd$x = gelu(embedded$x * h6 + last$x * h7.x + h7.y);
            } else {
                va$x = input(sample, i, row, quad$x);
                vb$x = input(sample, i + 1u, row, quad$x);
                vc$x = input(sample, i + 2u, row, quad$x);
                vd$x = input(sample, i + 3u, row, quad$x);
            }
            let wa$q = $same(vec4f(skip[at + $q]));
            let wb$q = $same(vec4f(skip[at + $m + $q]));
            let wc$q = $same(vec4f(skip[at + 2u * $m + $q]));
            let wd$q = $same(vec4f(skip[at + 3u * $m + $q]));
            y$c += (wa$q.$e * va$x + wb$q.$e * vb$x) + (wc$q.$e * vc$x + wd$q.$e * vd$x);
            at += 4u * $m;
        }
        at = line * columns * params.channels / 4u + tile * $m;
        for (var k = 0u; k < columns; k += 2u) {
            let va$x = tables[k * params.row_quads + quad$x];
            let vb$x = tables[(k + 1u) * params.row_quads + quad$x];
            let wa$q = $same(r[at + $q]);
            let wb$q = $same(r[at + params.channels / 4u + $q]);
            y$c += wa$q.$e * va$x + wb$q.$e * vb$x;
            at += params.channels / 2u;
        }
    }
    let b$q = $same(bias[tile * $m + $q]);
    y$c += b$q.$e;
    if GELU {
        y$c = gelu(y$c);
    }
    if FIELD {
        var sum$x = vec4f();
        let h$q = $same(bias[params.channels / 4u + tile * $m + $q]);
        sum$x += h$q.$e * y$c;
        // Memory holds [LINES, SPAN, DEEP, WIDE] quads. The first invocation of each quad adds them up.
        memory[$x * WIDE * DEEP + index] = sum$x;
        workgroupBarrier();
        if depth == 0u {
            for (var other = 1u; other < DEEP; other++) {
                sum$x += memory[($x * DEEP + other) * WIDE + index];
            }
            let part = tile / DEEP;
            if part == 0u {
                sum$x += bias[params.channels / 2u].x;
            }
            let out = part * params.samples * params.rows;
            if exists$x { keep_quad((out + line$x) * params.row_quads + quad$x, sum$x); }
        }
        return;
    }
    let out$x = (line$x * params.channels + tile * $n) * params.row_quads + quad$x;
    if exists$x { keep_output(out$x + $o * params.row_quads, y$c); }
    if !ROWS && !POOL {
        return;
    }
    let first_channel = first_tile * $n;
#if broadcast
    // A row is summed in registers, then over the lanes of each subgroup. Memory holds the subgroups' parts,
    // [DEEP, WIDE / 8, columns, tile] of ROWS, then [DEEP, WIDE / 8, tile] of POOL, in quads.
    let subgroups = WIDE / 8u;
    let sums = params.columns * $m;
    // The lifting has no other table.
    let forward = columns * params.row_quads;
    if ROWS {
        for (var k = 0u; k < params.columns; k++) {
            let f$x = select(vec4f(), tables[forward + quad$x * params.columns + k], exists$x);
            var z$q = vec4f();
            z$q.$e += dot(y$c, f$x);
            z$q = sum_of_lanes(z$q);
            for (var first = 0u; first < $m; first += 8u) {
                let own = first + index % 8u;
                var z = vec4f();
                z = select(z, z$q, own == $qu);
                if own < $m { memory[index / 8u * sums + k * $m + own] = z; }
            }
        }
    }
    let maxima = select(0u, DEEP * subgroups * sums, ROWS);
    if POOL {
        // Columns of the last quad beyond W repeat the quad's first one, and quads beyond the last one repeat
        // that one.
        let inside$x = vec4u(0u, 1u, 2u, 3u) + 4u * quad$x < vec4u(params.width);
        var most$q = vec4f(-3.402823e38);
        most$q.$e = max(most$q.$e, largest_of(select(vec4f(y$c.x), y$c, inside$x)));
        most$q = largest_of_lanes(most$q);
        for (var first = 0u; first < $m; first += 8u) {
            let own = first + index % 8u;
            var most = vec4f();
            most = select(most, most$q, own == $qu);
            if own < $m { memory[maxima + index / 8u * $m + own] = most; }
        }
    }
    workgroupBarrier();
    if ROWS {
        for (var k = index; k < DEEP * sums; k += WIDE * DEEP) {
            let part = k / sums * subgroups * sums + k % sums;
            var z = memory[part];
            for (var other = 1u; other < subgroups; other++) {
                z += memory[part + other * sums];
            }
            let to = (line * params.columns + k % sums / $m) * params.channels + first_channel;
            keep_quad(to / 4u + k / sums * $m + k % $m, z);
        }
    }
    if POOL {
        for (var k = index; k < DEEP * $m; k += WIDE * DEEP) {
            let part = maxima + k / $m * subgroups * $m + k % $m;
            var most = memory[part];
            for (var other = 1u; other < subgroups; other++) {
                most = max(most, memory[part + other * $m]);
            }
            let to = line * params.channels + first_channel + 4u * k;
            keep_largest(to, most.x);
            keep_largest(to + 1u, most.y);
            keep_largest(to + 2u, most.z);
            keep_largest(to + 3u, most.w);
        }
    }
#else
    // Memory holds the workgroup's part of a row of y, [DEEP, tile / 4, 4, Q]. The strides are odd, so that the lanes
    // that read together, each a channel or a quad of channels at the same place of the row, find them in
    // different banks.
    let stride = params.row_quads | 1u;
    let of_quad = 4u * stride + 1u;
    for (var l = 0u; l < LINES; l++) {
        if l > 0u { workgroupBarrier(); }
        // Of rows beyond the last one nothing is written.
        let is_row = row + l <= last_row;
        let keeps$x = exists$x && $xu / SPAN == l;
        if keeps$x { memory[(depth * $m + $o / 4u) * of_quad + $o % 4u * stride + quad$x] = y$c; }
        workgroupBarrier();
        if ROWS {
            // A part is some columns k of a quad of channels. Invocations beyond the last one compute it, too.
            let quads = DEEP * $m;
            let parts = quads * (params.columns / $t);
            let forward = columns * params.row_quads;
            for (var begin = 0u; begin < parts; begin += WIDE * DEEP) {
                let part = min(begin + index, parts - 1u);
                let column = part / quads * $t;
                let at = part % quads * of_quad;
                var z$k = vec4f();
                for (var q = 0u; q < params.row_quads; q++) {
                    let v = mat4x4f(memory[at + q], memory[at + stride + q], memory[at + 2u * stride + q], memory[at + 3u * stride + q]);
                    let t$k = $same(tables[forward + q * params.columns + column + $k]);
                    z$k += t$k * v;
                }
                if is_row && begin + index < parts {
                    let to = (((line + l) * params.columns + column) * params.channels + first_channel) / 4u + part % quads;
                    keep_quad(to + $k * params.channels / 4u, z$k);
                }
            }
        }
        if POOL {
            for (var o = index; o < DEEP * $n; o += WIDE * DEEP) {
                let at = o / 4u * of_quad + o % 4u * stride;
                var most = memory[at];
                let last = params.row_quads - 1u;
                for (var q = 1u; q < last; q++) {
                    most = max(most, memory[at + q]);
                }
                // Columns of the last quad beyond W repeat the quad's first one, which always exists.
                let v = memory[at + last];
                let inside = vec4u(0u, 1u, 2u, 3u) + 4u * last < vec4u(params.width);
                most = max(most, select(vec4f(v.x), v, inside));
                if is_row { keep_largest((line + l) * params.channels + first_channel + o, largest_of(most)); }
            }
        }
    }
#endif
}

fn largest_of(v: vec4f) -> f32 {
    return max(max(v.x, v.y), max(v.z, v.w));
}

#if broadcast
fn sum_of_lanes(v: vec4f) -> vec4f {
    let pairs = v + subgroupShuffleXor(v, 1u);
    let fours = pairs + subgroupShuffleXor(pairs, 2u);
    return fours + subgroupShuffleXor(fours, 4u);
}

fn largest_of_lanes(v: vec4f) -> vec4f {
    let pairs = max(v, subgroupShuffleXor(v, 1u));
    let fours = max(pairs, subgroupShuffleXor(pairs, 2u));
    return max(fours, subgroupShuffleXor(fours, 4u));
}
#endif

fn keep_quad(quad: u32, v: vec4f) {
    rows_or_field[4u * quad] = v.x;
    rows_or_field[4u * quad + 1u] = v.y;
    rows_or_field[4u * quad + 2u] = v.z;
    rows_or_field[4u * quad + 3u] = v.w;
}
