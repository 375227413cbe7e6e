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
// whole row in a workgroup, WIDE * SPAN >= Q. With FIELD, instead of y the last layer of the field head, as `project` makes it,
// in parts to be added up: made[part, s, i, j] = sum_o head[o] y[s, i, o, j] over the channels of a workgroup; the first has the
// head's bias.
//
// x: [S, H, C or E, Q] quads; y: [S, H, C, Q] quads; skip: [C / tile, inputs, tile]; bias: [C], then with FIELD head: [C] and its
// bias; r: [S, H, 2 modes_w, C], or [inputs, (E + 1) in quads]; made: [S, H, 2 modes_w, C], or [parts, S, H, Q] quads;
// rows_max: [S, H, C]; tables: [2 modes_w, Q] quads of table, then [Q, 2 modes_w] quads of forward; of the lifting, forward alone.
// The second tile is the number of columns k of `made` that an invocation sums for a quad of channels, a divisor of them.
// One invocation: SPAN quads, WIDE apart, and a tile of output channels. With STAGED, inputs and weights go through workgroup memory,
// CHUNK inputs at a time: each is read once for all of the workgroup, and in parallel.
// Workgroups: (Q / SPAN, H, S * C / tile) by WIDE x 1 x DEEP invocations, those of a row side by side.
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
override SPAN: u32 = 1;
override DEEP: u32 = 1;
override CHUNK: u32 = 1;
// Quads of the workgroup's memory: the largest of what the kinds of work want, see there.
override MEMORY: u32 = 1;

var<workgroup> memory: array<vec4f, MEMORY>;

// Subgroups want workgroups of one dimension.
@compute @workgroup_size(WIDE * DEEP)
fn block(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3u$lane) {
    let depth = index / WIDE;
    let row = group.y;
    let tiles = params.channels / $n;
    let sample = group.z * DEEP / tiles;
    let first_tile = group.z * DEEP % tiles;
    let tile = first_tile + depth;
    let columns = select(params.columns, 0u, LIFTING);
    let line = sample * params.rows + row;
    let first_quad = group.x * WIDE * SPAN;
    let place$x = first_quad + $x * WIDE + index % WIDE;
    let exists$x = place$x < params.row_quads;
    // Invocations beyond the last quad take part in what a subgroup shares.
    let quad$x = min(place$x, params.row_quads - 1u);
    var y$c = vec4f();
    prepare(sample, row, first_quad, index);
    if STAGED {
        // Inputs [CHUNK, SPAN, WIDE], then their weights [CHUNK, DEEP, tile].
        let all = params.inputs + columns;
        let inputs = CHUNK * SPAN * WIDE;
        for (var begin = 0u; begin < all; begin += CHUNK) {
            workgroupBarrier();
            for (var k = index; k < inputs; k += WIDE * DEEP) {
                let i = begin + k / (SPAN * WIDE);
                let q = min(first_quad + k % (SPAN * WIDE), params.row_quads - 1u);
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
                memory[inputs + k] = w;
            }
            workgroupBarrier();
            for (var i = 0u; i < CHUNK; i++) {
                let v$x = memory[(i * SPAN + $x) * WIDE + index % WIDE];
                let w$q = memory[inputs + (i * DEEP + depth) * $m + $q];
                y$c += w$q.$e * v$x;
            }
        }
        workgroupBarrier();
    } else {
        // Several inputs at a time: sums that do not fit the registers are read and written once for all of them.
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
        // [SPAN, DEEP, WIDE]: the first invocation of a quad adds up.
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
            let out = (part * params.samples * params.rows + line) * params.row_quads;
            if exists$x { keep_quad(out + quad$x, sum$x); }
        }
        return;
    }
    let out = (line * params.channels + tile * $n) * params.row_quads;
    if exists$x { y[out + $o * params.row_quads + quad$x] = StoredQuad(y$c); }
    if !ROWS && !POOL {
        return;
    }
    // The workgroup's part of y, [DEEP, tile, Q]; an odd number of quads to a row spreads equal places over the banks.
    let stride = params.row_quads | 1u;
    if exists$x { memory[(depth * $n + $o) * stride + quad$x] = y$c; }
    workgroupBarrier();
    let first_channel = first_tile * $n;
    if ROWS {
        // A part is some columns k of a quad of channels. Invocations beyond the last one take part in what a subgroup shares.
        let quads = DEEP * $m;
        let parts = quads * (params.columns / $t);
        let forward = columns * params.row_quads;
        for (var begin = 0u; begin < parts; begin += WIDE * DEEP) {
            let part = min(begin + index, parts - 1u);
            let column = part / quads * $t;
            let at = 4u * (part % quads) * stride;
            var z$k = vec4f();
            for (var q = 0u; q < params.row_quads; q++) {
                let v = mat4x4f(memory[at + q], memory[at + stride + q], memory[at + 2u * stride + q], memory[at + 3u * stride + q]);
                let t$k = $same(tables[forward + q * params.columns + column + $k]);
                z$k += t$k * v;
            }
            if begin + index < parts {
                let to = ((line * params.columns + column) * params.channels + first_channel) / 4u + part % quads;
                keep_quad(to + $k * params.channels / 4u, z$k);
            }
        }
    }
    if POOL {
        for (var o = index; o < DEEP * $n; o += WIDE * DEEP) {
            var most = memory[o * stride];
            let last = params.row_quads - 1u;
            for (var q = 1u; q < last; q++) {
                most = max(most, memory[o * stride + q]);
            }
            // Columns of the last quad beyond W repeat its first one, which always exists.
            let v = memory[o * stride + last];
            let inside = vec4u(0u, 1u, 2u, 3u) + 4u * last < vec4u(params.width);
            most = max(most, select(vec4f(v.x), v, inside));
            keep_largest(line * params.channels + first_channel + o, max(max(most.x, most.y), max(most.z, most.w)));
        }
    }
}

fn keep_quad(quad: u32, v: vec4f) {
    made[4u * quad] = v.x;
    made[4u * quad + 1u] = v.y;
    made[4u * quad + 2u] = v.z;
    made[4u * quad + 3u] = v.w;
}
