// One radix-4 pass of a Stockham transform along the middle axis of [lines, n, inner]; self-sorting, without
// bit reversal.
//
// Earlier passes left l = span groups of 4 s = n / l elements. For k < l, t < s and p = 0..3:
//   result[k + l p, t] = sum_q source[k, q s + t] w^(q k) (sign i)^(q p), q = 0..3
// where sign is that of the exponent and w = exp(sign 2 pi i / (4 l)).
//
// table: [n] complex, exp(2 pi i j / n)
// source, result: [B, lines, n, inner] complex
//
// One invocation per butterfly, four elements. Workgroups: (butterflies / 64 over x and y, B in z).
// Adjoint: the adjoint of a whole transform is the transform of opposite sign.

struct Params {
    count: u32, // butterflies of one item of the batch
    length: u32, // n
    inner: u32,
    span: u32, // l
    sign: f32, // -1 forward, 1 inverse
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<vec2f>;
@group(0) @binding(2) var<storage, read> source: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> result: array<vec2f>;

// Returns z times the j-th root of the table, conjugated for the forward transform.
fn times_root(z: vec2f, j: u32) -> vec2f {
    let w = vec2f(table[j].x, params.sign * table[j].y);
    return vec2f(z.x * w.x - z.y * w.y, z.x * w.y + z.y * w.x);
}

@compute @workgroup_size(64)
fn radix4(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let butterfly = (group.y * groups.x + group.x) * 64u + lane;
    if butterfly >= params.count {
        return;
    }
    let quarter = params.length / 4u;
    let column = butterfly % params.inner;
    let place = butterfly / params.inner % quarter; // k s + t
    let line = butterfly / params.inner / quarter;
    let s = quarter / params.span;
    let k = place / s;
    let first = (4u * group.z * params.count) + line * params.length * params.inner + column;
    let at = first + (place + 3u * k * s) * params.inner;
    let step = s * params.inner;
    let z0 = source[at];
    let z1 = times_root(source[at + step], k * s);
    let z2 = times_root(source[at + 2u * step], 2u * k * s);
    let z3 = times_root(source[at + 3u * step], 3u * k * s);
    let odd = z1 - z3;
    let quarter_turn = params.sign * vec2f(-odd.y, odd.x);
    let out = first + place * params.inner;
    let stride = quarter * params.inner;
    result[out] = (z0 + z2) + (z1 + z3);
    result[out + stride] = (z0 - z2) + quarter_turn;
    result[out + 2u * stride] = (z0 + z2) - (z1 + z3);
    result[out + 3u * stride] = (z0 - z2) - quarter_turn;
}
