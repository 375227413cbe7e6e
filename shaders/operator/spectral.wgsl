// Spectral convolution along the columns of the rows' spectra: transform, channel product per mode, inverse.
//
//   spectrum[s, m_h, m_w, i] = sum_y r[s, y, m_w, i] exp(-2 pi i k_h y / H)
//   product[s, m_h, m_w, o] = sum_i spectrum[s, m_h, m_w, i] weight[m_h, m_w, i, o]
//   inverse[s, y, m_w, o] = sum_m_h product[s, m_h, m_w, o] exp(2 pi i k_h y / H)
// All are complex, and k_h = m_h - modes_h / 2. Waves of opposite k_h have the same cosine and opposite
// sines, so both are summed from the same four products. The inverse along the rows follows in `block`, which
// drops the imaginary part of column 0, as an inverse real transform does with the non-Hermitian part of that
// column.
//
// table: [H, tile], (cos, sin)(2 pi k y / H)
// weight: [modes_h modes_w, C / 2, C] pairs of complex numbers, of the inputs 2 k and 2 k + 1
// r, inverse: [S, H, modes_w, (re, im), C]
// spectrum: [S, modes_h, modes_w, C] complex, written if KEEP
//
// One workgroup per OUT_CHANNELS output channels of a kept column, for a tile of samples. It first computes
// the spectrum of all input channels in workgroup memory. With fewer output channels there are more
// workgroups, but each column is transformed more often. Its invocations divide up the rows and channels of
// the transform, then the inputs and modes of the product, then strips of rows of the inverse. Every sum
// consists of PARTS partial sums, whether one invocation computes all of them or only one, so that results do
// not depend on how the work is divided.
// C is a multiple of 16, and so are the inputs of a part, which are read sixteen at a time.
// The tile is modes_h / 2 + 1, the number of magnitudes k of k_h. The second tile is the number of samples
// that share one read of the weights. It divides S.
// Workgroups: (modes_w * C / OUT_CHANNELS, S / second tile).
// Adjoint: itself with the `spectral_transpose`d weight (r), `spectral_weight_adj` (weight).

struct Params {
    channels: u32, // C
    rows: u32, // H
    modes_w: u32,
    strip: u32, // consecutive rows of the inverse per invocation
}

@group(0) @binding(0) var<uniform> params: Params;
#if texels
@group(0) @binding(1) var table: texture_2d<f32>;
@group(0) @binding(2) var weight: texture_2d<f32>;
#else
@group(0) @binding(1) var<storage, read> table: array<vec2f>;
@group(0) @binding(2) var<storage, read> weight: array<StoredQuad>;
#endif
@group(0) @binding(3) var<storage, read> r: array<f32>;
@group(0) @binding(4) var<storage, read_write> inverse: array<f32>;
@group(0) @binding(5) var<storage, read_write> spectrum: array<vec2f>;

override KEEP: bool = false;
override MODES: u32 = 8; // modes_h
override LANES: u32 = 256;
override OUT_CHANNELS: u32 = 64;
override PARTS: u32 = 1;
// Parts of a column's rows, and of the input channels, that separate invocations sum: 1 or PARTS.
override ROW_PARTS: u32 = 1;
override INPUT_PARTS: u32 = 1;
// Elements of `inputs`, MODES * second tile * C * ROW_PARTS, and of `outputs`, MODES * second tile *
// OUT_CHANNELS * INPUT_PARTS.
override INPUTS: u32 = 2048;
override OUTPUTS: u32 = 2048;

// [second tile, ROW_PARTS, MODES, C] and [INPUT_PARTS, second tile, MODES, OUT_CHANNELS].
var<workgroup> inputs: array<vec2f, INPUTS>;
var<workgroup> outputs: array<vec2f, OUTPUTS>;

// In every loop, invocations beyond the last item still take part in subgroup broadcasts.
@compute @workgroup_size(LANES)
fn spectral(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3u$lane) {
    let channels = params.channels;
    let column = group.x % params.modes_w;
    let slice = group.x / params.modes_w * OUT_CHANNELS;
    let first = group.y * $t;
    let row_part = (params.rows + PARTS - 1u) / PARTS;
    let transforms = $t * ROW_PARTS * channels;
    for (var begin = 0u; begin < transforms; begin += LANES) {
        let item = min(begin + index, transforms - 1u);
        let channel = item % channels;
        let of_parts = item / channels;
        let sample = first + of_parts / ROW_PARTS;
        // Modes -k (xy) and k (zw).
        var z$c = vec4f();
        for (var turn = 0u; turn < PARTS / ROW_PARTS; turn++) {
            let top = (of_parts % ROW_PARTS + turn) * row_part;
            let bottom = min(top + row_part, params.rows);
            // Sums of re cos, im sin, im cos and re sin.
            var part$c = vec4f();
#if broadcast
            for (var y = top; y < bottom; y++) {
                let at = ((sample * params.rows + y) * params.modes_w + column) * 2u * channels + channel;
                let re = r[at];
                let im = r[at + channels];
                let t$c = $same(wave(y * $n + $c));
                part$c += vec4f(re, im, im, re) * t$c.xyxy;
            }
#else
            // Four rows at a time, whose loads are all under way before the first is awaited. Those beyond the
            // last one count as zero.
            for (var y = top; y < bottom; y += 4u) {
                let y$4 = min(y + $4, bottom - 1u);
                let at$4 = ((sample * params.rows + y$4) * params.modes_w + column) * 2u * channels + channel;
                let re$4 = r[at$4];
                let im$4 = r[at$4 + channels];
                let t$4_$c = wave(y$4 * $n + $c);
                let v$4 = select(vec4f(), vec4f(re$4, im$4, im$4, re$4), y + $4 < bottom);
                part$c += v$4 * t$4_$c.xyxy;
            }
#endif
            z$c += vec4f(part$c.xz, part$c.xz) + vec4f(-part$c.y, part$c.w, part$c.y, -part$c.w);
        }
        if begin + index < transforms {
            let zero = (of_parts * MODES + MODES / 2u) * channels + channel;
            inputs[zero - $cu * channels] = z$c.xy;
            if $cu + MODES / 2u < MODES { inputs[zero + $cu * channels] = z$c.zw; }
        }
    }
    workgroupBarrier();
    if ROW_PARTS > 1u {
        // The sum replaces its first part.
        for (var k = index; k < $t * MODES * channels; k += LANES) {
            let at = k + k / (MODES * channels) * (ROW_PARTS - 1u) * MODES * channels;
            var sum = inputs[at];
            for (var part = 1u; part < ROW_PARTS; part++) {
                sum += inputs[at + part * MODES * channels];
            }
            inputs[at] = sum;
        }
        workgroupBarrier();
    }
    if KEEP && slice == 0u {
        for (var k = index; k < $t * MODES * channels; k += LANES) {
            let mode = k / channels;
            let of_tile = mode / MODES;
            spectrum[((first * MODES + mode) * params.modes_w + column) * channels + k % channels] =
                inputs[k + of_tile * (ROW_PARTS - 1u) * MODES * channels];
        }
    }
    let input_part = (channels / 16u + PARTS - 1u) / PARTS * 16u;
    let products = MODES * INPUT_PARTS * OUT_CHANNELS;
    for (var begin = 0u; begin < products; begin += LANES) {
        let item = min(begin + index, products - 1u);
        let channel = min(slice + item % OUT_CHANNELS, channels - 1u);
        let of_parts = item / OUT_CHANNELS;
        let mode = of_parts / INPUT_PARTS;
        let part = of_parts % INPUT_PARTS;
        var p$k = vec2f();
        for (var turn = 0u; turn < PARTS / INPUT_PARTS; turn++) {
            let to = min((part + turn + 1u) * input_part, channels);
            var part$k = vec2f();
            for (var i = (part + turn) * input_part; i < to; i += 16u) {
                let pair = ((mode * params.modes_w + column) * channels + i) / 2u;
#if texels
                let w$8 = textureLoad(weight, texel((pair + $8) * channels + channel), 0);
#else
                let w$8 = vec4f(weight[(pair + $8) * channels + channel]);
#endif
#if broadcast
                let u$k_$8 = $same(inputs[($k * ROW_PARTS * MODES + mode) * channels + i + 2u * $8]);
                let v$k_$8 = $same(inputs[($k * ROW_PARTS * MODES + mode) * channels + i + 2u * $8 + 1u]);
                part$k += weighted(u$k_$8, v$k_$8, w$8);
#else
                // Read where they are used: all of them at once would not fit in registers.
                let at$k = ($k * ROW_PARTS * MODES + mode) * channels + i;
                part$k += weighted(inputs[at$k + 2u * $8], inputs[at$k + 2u * $8 + 1u], w$8);
#endif
            }
            p$k += part$k;
        }
        if begin + index < products {
            outputs[((part * $t + $k) * MODES + mode) * OUT_CHANNELS + item % OUT_CHANNELS] = p$k;
        }
    }
    workgroupBarrier();
    let strips = (params.rows + params.strip - 1u) / params.strip;
    let inverses = $t * strips * OUT_CHANNELS;
    for (var begin = 0u; begin < inverses; begin += LANES) {
        let item = min(begin + index, inverses - 1u);
        let channel = slice + item % OUT_CHANNELS;
        let of_tile = item / OUT_CHANNELS % $t;
        let top = item / (OUT_CHANNELS * $t) * params.strip;
        let bottom = min(top + params.strip, params.rows);
        let zero = (of_tile * MODES + MODES / 2u) * OUT_CHANNELS + item % OUT_CHANNELS;
        let lower$c = product(zero - $cu * OUT_CHANNELS);
        var upper$c = vec2f();
        if $cu > 0u && $cu + MODES / 2u < MODES { upper$c = product(zero + $cu * OUT_CHANNELS); }
        let q$c = vec4f(upper$c + lower$c, upper$c - lower$c);
        for (var y = top; y < bottom; y++) {
            var re = 0.0;
            var im = 0.0;
            let t$c = $same(wave(y * $n + $c));
            re += q$c.x * t$c.x - q$c.w * t$c.y;
            im += q$c.y * t$c.x + q$c.z * t$c.y;
            if begin + index < inverses && channel < channels {
                let at = (((first + of_tile) * params.rows + y) * params.modes_w + column) * 2u * channels + channel;
                inverse[at] = re;
                inverse[at + channels] = im;
            }
        }
    }
}

// Returns the sum of two inputs, with their weights.
fn weighted(u: vec2f, v: vec2f, w: vec4f) -> vec2f {
    return vec2f(u.x * w.x - u.y * w.y, u.x * w.y + u.y * w.x) + vec2f(v.x * w.z - v.y * w.w, v.x * w.w + v.y * w.z);
}

// Returns this element of the table.
fn wave(at: u32) -> vec2f {
#if texels
    let two = textureLoad(table, texel(at / 2u), 0);
    return select(two.xy, two.zw, at % 2u == 1u);
#else
    return table[at];
#endif
}

// Returns the product whose first part is at this index.
fn product(at: u32) -> vec2f {
    var sum = outputs[at];
    for (var part = 1u; part < INPUT_PARTS; part++) {
        sum += outputs[at + part * (OUTPUTS / INPUT_PARTS)];
    }
    return sum;
}
