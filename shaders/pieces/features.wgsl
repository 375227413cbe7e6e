
// Input of the network, from two bindings of the kernel.
//
// fields: gradient [S, H, W], then from element `hidden` on last gradient and last step, [S, H, W] each
// partial_sums: [S, parts, 2] from sum `first_sum` on, partial sums of the squares of gradient and last step
//   (`gradient`)

// Location of the fields of a sample.
struct FieldsOf {
    sample: u32, // index among all S
    samples: u32, // S
    rows: u32, // H
    columns: u32, // W
    hidden: u32,
    parts: u32,
    first_sum: u32,
}

// Sixteen partial sums for each of the two norms, interleaved.
var<workgroup> sums_of_parts: array<f32, 32>;

// Returns sqrt n / |g| and sqrt n / |d| of a sample. All `lanes` invocations of a workgroup must call it. The
// root mean square has a floor of 1e-19, so that a zero field stays zero and one whose squares are subnormal
// is not blown up.
fn inverse_rms(at: FieldsOf, index: u32, lanes: u32) -> vec2f {
    for (var k = index; k < 32u; k += lanes) {
        var sum = 0.0;
        for (var part = k / 2u; part < at.parts; part += 16u) {
            sum += partial_sums[2u * (at.first_sum + at.sample * at.parts + part) + k % 2u];
        }
        sums_of_parts[k] = sum;
    }
    workgroupBarrier();
    var squares = vec2f();
    for (var k = 0u; k < 32u; k += 2u) {
        squares += vec2f(sums_of_parts[k], sums_of_parts[k + 1u]);
    }
    let root = sqrt(f32(at.rows * at.columns));
    return root / max(sqrt(squares), vec2f(1e-19 * root));
}

// Returns channel e at a quad of a row, zero beyond the last column.
fn feature(at: FieldsOf, inverse: vec2f, e: u32, row: u32, quad: u32) -> vec4f {
    let columns = vec4u(0u, 1u, 2u, 3u) + 4u * quad;
    let inside = columns < vec4u(at.columns);
    if e == 3u {
        return select(vec4f(), vec4f(f32(row) / f32(at.rows - 1u)), inside);
    }
    if e == 4u {
        return select(vec4f(), vec4f(columns) / f32(at.columns - 1u), inside);
    }
    let n = at.rows * at.columns;
    let field = select(at.hidden + (e - 1u) * at.samples * n, 0u, e == 0u);
    let first = field + at.sample * n + row * at.columns + 4u * quad;
    var v = vec4f();
    // Unrolled by hand: DirectX's older compiler drops stores at a variable index.
    if inside.x { v.x = fields[first]; }
    if inside.y { v.y = fields[first + 1u]; }
    if inside.z { v.z = fields[first + 2u]; }
    if inside.w { v.w = fields[first + 3u]; }
    return 10.0 * tanh_exact(0.1 * v * select(inverse.x, inverse.y, e == 2u));
}
