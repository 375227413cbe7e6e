// Spectral convolution along the columns of the kept rows' spectra: transform, channel product of each mode, inverse.
//
// spectrum[s, m_h, m_w, i] = sum_y r[s, y, m_w, i] table[y, m_h], complex;
// product[s, m_h, m_w, o] = sum_i spectrum[s, m_h, m_w, i] weight[m_h, m_w, i, o], complex;
// inverse[s, y, m_w, o] = sum_m_h product[s, m_h, m_w, o] conj(table[y, m_h]), complex.
// table[y, m_h] = exp(-2 pi i k_h y / H) with k_h = m_h - modes_h / 2. The inverse rows follow inside `block`, which drops the
// imaginary part of column 0: what an inverse real transform does with the non-Hermitian part of that column.
// r, inverse: [S, H, modes_w, (re, im), C]; table: [H, tile] complex; weight: [modes_h modes_w, C, C] complex;
// spectrum: [S, modes_h, modes_w, C] complex, written if KEEP. The tile is modes_h; the second tile is the number of samples
// that share one reading of the weights; S is a multiple of it.
// One workgroup: 64 output channels of one kept column of a tile of samples. It makes the spectrum of all input channels in
// workgroup memory first; TEAMS times 64 invocations share its samples and channels (which may be fewer than there are teams),
// then the modes, then strips of rows.
// Workgroups: (modes_w * C / 64, S / second tile).
// Adjoint: itself with the `spectral_transpose`d weight (r), `spectral_weight_adj` (weight).

struct Params {
    channels: u32, // C
    rows: u32, // H
    modes_w: u32,
    strip: u32, // rows of the inverse that an invocation takes in turn
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<vec2f>;
@group(0) @binding(2) var<storage, read> weight: array<StoredPair>;
@group(0) @binding(3) var<storage, read> r: array<f32>;
@group(0) @binding(4) var<storage, read_write> inverse: array<f32>;
@group(0) @binding(5) var<storage, read_write> spectrum: array<vec2f>;

override KEEP: bool = false;
override TEAMS: u32 = 4;
// Elements of the workgroup's memory: tile * second tile * C, and as many with 64 in place of C.
override INPUTS: u32 = 2048;
override OUTPUTS: u32 = 2048;

var<workgroup> inputs: array<vec2f, INPUTS>;
var<workgroup> outputs: array<vec2f, OUTPUTS>;

@compute @workgroup_size(64, TEAMS)
fn spectral(@builtin(local_invocation_id) local: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    let across = local.x;
    let team = local.y;
    let column = group.x % params.modes_w;
    let slice = group.x / params.modes_w * 64u;
    let first = group.y * $t;
    let slices = (params.channels + 63u) / 64u;
    for (var part = team; part < $t * slices; part += TEAMS) {
        // Invocations beyond the last channel take part in what a subgroup shares.
        let channel = part / $t * 64u + across;
        let source = min(channel, params.channels - 1u);
        let of_tile = part % $t;
        var z$c = vec2f();
        for (var y = 0u; y < params.rows; y++) {
            let at = (((first + of_tile) * params.rows + y) * params.modes_w + column) * 2u * params.channels + source;
            let re = r[at];
            let im = r[at + params.channels];
            let t$c = $same(table[y * $n + $c]);
            z$c += vec2f(re * t$c.x - im * t$c.y, re * t$c.y + im * t$c.x);
        }
        if channel < params.channels {
            inputs[(of_tile * $n + $c) * params.channels + channel] = z$c;
            if KEEP && slice == 0u {
                let out = ((first + of_tile) * $n * params.modes_w + column) * params.channels + channel;
                spectrum[out + $c * params.modes_w * params.channels] = z$c;
            }
        }
    }
    workgroupBarrier();
    let channel = min(slice + across, params.channels - 1u);
    for (var mode = team; mode < $n; mode += TEAMS) {
        var p$k = vec2f();
        for (var i = 0u; i < params.channels; i++) {
            let at = ((mode * params.modes_w + column) * params.channels + i) * params.channels + channel;
            let w = vec2f(weight[at]);
            let x$k = $same(inputs[($k * $n + mode) * params.channels + i]);
            p$k += vec2f(x$k.x * w.x - x$k.y * w.y, x$k.x * w.y + x$k.y * w.x);
        }
        outputs[($k * $n + mode) * 64u + across] = p$k;
    }
    workgroupBarrier();
    let strips = (params.rows + params.strip - 1u) / params.strip;
    for (var part = team; part < $t * strips; part += TEAMS) {
        let of_tile = part % $t;
        let begin = part / $t * params.strip;
        let end = min(begin + params.strip, params.rows);
        let q$c = outputs[(of_tile * $n + $c) * 64u + across];
        for (var y = begin; y < end; y++) {
            var re = 0.0;
            var im = 0.0;
            let t$c = $same(table[y * $n + $c]);
            re += q$c.x * t$c.x + q$c.y * t$c.y;
            im += q$c.y * t$c.x - q$c.x * t$c.y;
            if slice + across < params.channels {
                let at = (((first + of_tile) * params.rows + y) * params.modes_w + column) * 2u * params.channels + channel;
                inverse[at] = re;
                inverse[at + params.channels] = im;
            }
        }
    }
}
