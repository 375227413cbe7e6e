// Multiplication of four fields, or two, by the inverse Hessian of a sheet, between the transforms of their rows: the cosine transform
// along the columns, the division by the eigenvalues, and the transform back.
//
// With each field f from FIRST on,
//   y[f, k, l] = sum_i table[k, i] z[f, i, l] / lambda_f(k, l),  and then  z[f, i, l] = sum_k table[k, i] y[f, k, l]
//
// With N = H W, m = mu[k] and q = mu[H + l], the first three fields have the eigenvalue of a sheet at rest (see
// `rest_modes`), the next that across its surface, and the last two (FIELDS = 2) those along either axis of the sheet:
//   lambda_3 = TAU (w_u m + w_v q) + (NORMAL + 2 TAU k_stretch + 2 BEND (k_down m^2 + k_across q^2)) / N
//   lambda_4 = w_u (m + TAU q) + (TANGENTIAL + CONTACT c + 8 k_shear q + 2 k_across q^2) / N
//   lambda_5 = w_v (q + TAU m) + (TANGENTIAL + CONTACT c + 8 k_shear m + 2 k_down m^2) / N
// where w_u = 2 k_u (1 + t) / ((H - 1) W) and w_v = 2 k_v (1 + t) / (H (W - 1)), k_u and k_v are the coefficients of the stretch down
// and across, k_down and k_across those of the bend, k_stretch is that of the stretch of both axes, t its damping, and c is
// what contacts with bodies add.
//
// cloths: [B]
// table: [H, H], the orthonormal DCT-II
// mu: [H + W], 2 - 2 cos(pi k / H), then 2 - 2 cos(pi l / W)
// z: [B, 6, H, W], of which FIELDS from FIRST on are read, and in the end the results
// y: [B, 6, H, W], of which the same fields are overwritten
//
// One workgroup per 16 columns of a field, one invocation per 4 x 4 elements of LANES rows of them. No other workgroup touches these
// columns, so that both transforms are one dispatch.
// Workgroups: (W / 16, FIELDS B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> table: array<f32>;
@group(0) @binding(3) var<storage, read> mu: array<f32>;
@group(0) @binding(4) var<storage, read_write> z: array<f32>;
@group(0) @binding(5) var<storage, read_write> y: array<f32>;

// Share of an edge's stiffness that acts across it.
override TAU: f32 = 0.0003;
// 4 or 2, and the first of them.
override FIELDS: u32 = 4;
override FIRST: u32 = 0;
// Inertia along the sheet and across it, and bend across it, as multiples of those of a flat sheet.
override TANGENTIAL: f32 = 1;
// Share of what contacts add that counts along the sheet.
override CONTACT: f32 = 0;
override NORMAL: f32 = 1;
override BEND: f32 = 1;

// Whether field and table go through workgroup memory (`four_fields`).
override STAGED: bool = true;
// Invocations of a workgroup, at most 128: as many as a column has rows, in steps of 32.
override LANES: u32 = 128;

// Rows of the product that are summed at once.
const DEPTH: u32 = 16u;
// One more than there are quads, so that neighbours in depth are in different banks.
override QUADS_OF_ROWS: u32 = LANES / 4u + 1u;
const QUADS_OF_COLUMNS: u32 = 5u;
// Four rows of the table.
override FACTORS: u32 = DEPTH * QUADS_OF_ROWS;
var<workgroup> left: array<vec4f, FACTORS>;
// Four columns of the field.
var<workgroup> right: array<vec4f, DEPTH * QUADS_OF_COLUMNS>;

// A field of a cloth: where it begins in z and in y, its number there, and its cloth.
struct Field {
    first: u32,
    number: u32,
    cloth: u32,
}

// Returns the factors with which element i of a column enters four elements of the result, those of the last row past it.
fn quad_of_factors(row: u32, i: u32, inverse: bool) -> vec4f {
    return vec4f(
        factor(row, i, inverse),
        factor(row + 1u, i, inverse),
        factor(row + 2u, i, inverse),
        factor(row + 3u, i, inverse),
    );
}

fn factor(row: u32, i: u32, inverse: bool) -> f32 {
    let last = params.rows - 1u;
    let place = vec2u(min(row, last), min(i, last));
    return table[select(place.x * params.rows + place.y, place.y * params.rows + place.x, inverse)];
}

// Returns four elements of row i of a field.
fn quad_of_elements(field: Field, i: u32, column: u32, inverse: bool) -> vec4f {
    return vec4f(
        element(field, i, column, inverse),
        element(field, i, column + 1u, inverse),
        element(field, i, column + 2u, inverse),
        element(field, i, column + 3u, inverse),
    );
}

// Returns an element of a field: of y if `inverse`, else of z; 0 outside.
fn element(field: Field, row: u32, column: u32, inverse: bool) -> f32 {
    if row >= params.rows || column >= params.columns {
        return 0.0;
    }
    let at = row * params.columns + column;
    if inverse {
        return y[field.first + at];
    }
    return z[field.first + at];
}

// Returns the eigenvalues of a field of y in mode k of the columns and four modes of the rows.
fn eigenvalues(field: u32, k: u32, l: u32, cloth: Cloth) -> vec4f {
    let material = cloth.material;
    let weave = cloth.weave;
    let h = f32(params.rows);
    let w = f32(params.columns);
    let damped = 2.0 * (1.0 + cloth.gravity.w) * material.x;
    let by_u = damped * weave.x / ((h - 1.0) * w);
    let by_v = damped * weave.y / (h * (w - 1.0));
    let m = vec4f(mu[k]);
    let at = params.rows + l;
    let last = params.rows + params.columns - 1u;
    let q = vec4f(mu[at], mu[min(at + 1u, last)], mu[min(at + 2u, last)], mu[min(at + 3u, last)]);
    var stretch = by_u * m + by_v * q;
    let bend = 2.0 * material.z * (weave.z * m * m + weave.w * q * q);
    var others = vec4f(1.0);
    if field == 4u {
        stretch = by_u * (m + TAU * q);
        others = TANGENTIAL + CONTACT * material.w + 8.0 * material.y * q + 2.0 * material.z * weave.w * q * q;
    } else if field == 5u {
        stretch = by_v * (q + TAU * m);
        others = TANGENTIAL + CONTACT * material.w + 8.0 * material.y * m + 2.0 * material.z * weave.z * m * m;
    } else if field == 3u {
        stretch *= TAU;
        others = NORMAL + 2.0 * TAU * material.x + BEND * bend;
    } else {
        others += bend + 4.0 * material.y * (m + q) + material.w;
    }
    return stretch + others / (h * w);
}

// Writes four columns of a row of the result, as far as they exist: to z if `inverse`, else divided to y.
fn keep(field: Field, row: u32, column: u32, sum: vec4f, inverse: bool) {
    if row >= params.rows || column >= params.columns {
        return;
    }
    let at = row * params.columns + column;
    let columns = params.columns - column;
    if inverse {
        z[field.first + at] = sum.x;
        if columns > 1u { z[field.first + at + 1u] = sum.y; }
        if columns > 2u { z[field.first + at + 2u] = sum.z; }
        if columns > 3u { z[field.first + at + 3u] = sum.w; }
    } else {
        let v = sum / eigenvalues(field.number, row, column, cloths[field.cloth]);
        y[field.first + at] = v.x;
        if columns > 1u { y[field.first + at + 1u] = v.y; }
        if columns > 2u { y[field.first + at + 2u] = v.z; }
        if columns > 3u { y[field.first + at + 3u] = v.w; }
    }
}

// Four rows of four columns of a result.
struct Block {
    row0: vec4f,
    row1: vec4f,
    row2: vec4f,
    row3: vec4f,
}

fn add_product(block: Block, l: vec4f, r: vec4f) -> Block {
    return Block(block.row0 + l.x * r, block.row1 + l.y * r, block.row2 + l.z * r, block.row3 + l.w * r);
}

// Writes a block from this row and column on.
fn keep_block(field: Field, row: u32, column: u32, block: Block, inverse: bool) {
    keep(field, row, column, block.row0, inverse);
    keep(field, row + 1u, column, block.row1, inverse);
    keep(field, row + 2u, column, block.row2, inverse);
    keep(field, row + 3u, column, block.row3, inverse);
}

// Transforms the columns from `first_column` on of a field, forward from z to y or back from y to z.
fn transform_staged(field: Field, lane: u32, first_column: u32, inverse: bool) {
    let quads = LANES / 4u;
    for (var first_row = 0u; first_row < params.rows; first_row += LANES) {
        var block: Block;
        for (var first = 0u; first < params.rows; first += DEPTH) {
            workgroupBarrier();
            for (var k = lane; k < quads * DEPTH; k += LANES) {
                // Neighbouring invocations read neighbouring elements. Those of the table are along its rows,
                // which are rows of the result only if it is transposed.
                let place = select(vec2u(k % DEPTH, k / DEPTH), vec2u(k / quads, k % quads), inverse);
                left[place.x * QUADS_OF_ROWS + place.y] =
                    quad_of_factors(first_row + 4u * place.y, first + place.x, inverse);
            }
            for (var k = lane; k < 4u * DEPTH; k += LANES) {
                right[k / 4u * QUADS_OF_COLUMNS + k % 4u] =
                    quad_of_elements(field, first + k / 4u, first_column + 4u * (k % 4u), inverse);
            }
            workgroupBarrier();
            for (var k = 0u; k < DEPTH; k++) {
                let l = left[k * QUADS_OF_ROWS + lane / 4u];
                block = add_product(block, l, right[k * QUADS_OF_COLUMNS + lane % 4u]);
            }
        }
        keep_block(field, first_row + 4u * (lane / 4u), first_column + 4u * (lane % 4u), block, inverse);
    }
}

// As `transform_staged`, without workgroup memory.
fn transform(field: Field, lane: u32, first_column: u32, inverse: bool) {
    // Mesa's llvmpipe would compile the kernel anew for each dispatch if loops plainly ended at a parameter: it looks for those.
    let rows = params.rows + (lane >> 31u);
    let column = first_column + 4u * (lane % 4u);
    for (var row = 4u * (lane / 4u); row < rows; row += LANES) {
        var block: Block;
        for (var i = 0u; i < rows; i++) {
            let l = quad_of_factors(row, i, inverse);
            block = add_product(block, l, quad_of_elements(field, i, column, inverse));
        }
        keep_block(field, row, column, block, inverse);
    }
}

@compute @workgroup_size(LANES)
fn cosine_columns(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.y / FIELDS;
    let number = FIRST + group.y % FIELDS;
    let field = Field((6u * b + number) * params.rows * params.columns, number, b);
    // The way back reads what other invocations wrote.
    if STAGED {
        transform_staged(field, lane, 16u * group.x, false);
        storageBarrier();
        transform_staged(field, lane, 16u * group.x, true);
    } else {
        transform(field, lane, 16u * group.x, false);
        storageBarrier();
        transform(field, lane, 16u * group.x, true);
    }
}
