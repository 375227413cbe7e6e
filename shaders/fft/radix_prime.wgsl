// One pass of any radix r of a Stockham transform along the middle axis of [lines, n, inner], by direct sums.
//
// Earlier passes left l = span groups of r s = n / l elements. For k < l r and t < s:
//   result[k, t] = sum_q source[k mod l, q s + t] w^(q k), q = 0 .. r - 1
// where sign is that of the exponent and w = exp(sign 2 pi i / (l r)).
//
// table: [n] complex, exp(2 pi i j / n)
// source, result: [B, lines, n, inner] complex
//
// One invocation per element of the result. Workgroups: (elements / 64 over x and y, B in z).
// Adjoint: the adjoint of a whole transform is the transform of opposite sign.

struct Params {
    count: u32, // elements of one item of the batch
    length: u32, // n
    inner: u32,
    span: u32, // l
    radix: u32, // r
    sign: f32, // -1 forward, 1 inverse
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<vec2f>;
@group(0) @binding(2) var<storage, read> source: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> result: array<vec2f>;

@compute @workgroup_size(64)
fn radix_prime(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let element = (group.y * groups.x + group.x) * 64u + lane;
    if element >= params.count {
        return;
    }
    let column = element % params.inner;
    let place = element / params.inner % params.length; // k s + t
    let line = element / params.inner / params.length;
    let points = params.span * params.radix;
    let s = params.length / points;
    let k = place / s;
    let first = group.z * params.count + line * params.length * params.inner + column;
    var at = first + (k % params.span * params.radix * s + place % s) * params.inner;
    var power = 0u; // q k modulo l r
    var sum = vec2f();
    for (var q = 0u; q < params.radix; q++) {
        let z = source[at];
        let w = vec2f(table[power * s].x, params.sign * table[power * s].y);
        sum += vec2f(z.x * w.x - z.y * w.y, z.x * w.y + z.y * w.x);
        at += s * params.inner;
        power += k;
        power = select(power, power - points, power >= points);
    }
    result[group.z * params.count + element] = sum;
}
