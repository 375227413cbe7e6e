// Cosine transform along the columns of four fields, or two, and the division by the eigenvalues of a sheet.
//
// Forward:  out[f, k, l] = sum_i table[k, i] z[f, i, l] / lambda_f(k, l)
// INVERSE:  out[f, i, l] = sum_k table[k, i] z[f, k, l]
//
// With N = H W, m = mu[k] and q = mu[H + l], the first three of four fields have the eigenvalue of a sheet at rest (see
// `rest_modes`), the fourth that across its surface; two fields (FIELDS = 2) have those along either axis of the sheet:
//   lambda_3 = TAU (w_u m + w_v q) + (NORMAL + 2 TAU k_stretch + 2 BEND (k_down m^2 + k_across q^2)) / N
//   lambda_0 = w_u (m + TAU q) + (TANGENTIAL + 8 k_shear q + 2 k_across q^2) / N
//   lambda_1 = w_v (q + TAU m) + (TANGENTIAL + 8 k_shear m + 2 k_down m^2) / N
// where w_u = 2 k_u (1 + t) / ((H - 1) W) and w_v = 2 k_v (1 + t) / (H (W - 1)), k_u and k_v are the coefficients of the stretch down
// and across, k_down and k_across those of the bend, k_stretch is that of the stretch of both axes, and t its damping.
//
// cloths: [B]
// table: [H, H], the orthonormal DCT-II
// mu: [H + W], 2 - 2 cos(pi k / H), then 2 - 2 cos(pi l / W)
// z, out: [B, FIELDS, H, W]
//
// One invocation per 4 x 4 elements of the result. Workgroups: (W / 32, H / 32, FIELDS B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> table: array<f32>;
@group(0) @binding(3) var<storage, read> mu: array<f32>;
@group(0) @binding(4) var<storage, read> z: array<f32>;
@group(0) @binding(5) var<storage, read_write> out: array<f32>;

override INVERSE: bool = false;
// Share of an edge's stiffness that acts across it.
override TAU: f32 = 0.0003;
// 4 or 2.
override FIELDS: u32 = 4;
// Inertia along the sheet and across it, and bend across it, as multiples of those of a flat sheet.
override TANGENTIAL: f32 = 1;
override NORMAL: f32 = 1;
override BEND: f32 = 1;

// Rows of the product that are summed at once.
const DEPTH: u32 = 16u;
// One more than there are quads, so that neighbours in depth are in different banks.
const STRIDE: u32 = 9u;
// Four rows of the table, four columns of z.
var<workgroup> left: array<vec4f, DEPTH * STRIDE>;
var<workgroup> right: array<vec4f, DEPTH * STRIDE>;

// Returns the factors with which element i of a column of z enters four elements of the result; 0 outside.
fn quad_of_factors(row: u32, i: u32) -> vec4f {
    return vec4f(factor(row, i), factor(row + 1u, i), factor(row + 2u, i), factor(row + 3u, i));
}

fn factor(row: u32, i: u32) -> f32 {
    if row < params.rows && i < params.rows {
        return table[select(row * params.rows + i, i * params.rows + row, INVERSE)];
    }
    return 0.0;
}

// Returns an element of a field, 0 outside.
fn element(first: u32, row: u32, column: u32) -> f32 {
    if row < params.rows && column < params.columns {
        return z[first + row * params.columns + column];
    }
    return 0.0;
}

// Returns the eigenvalues of a field in mode k of the columns and four modes of the rows.
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
    if FIELDS == 2u && field == 0u {
        stretch = by_u * (m + TAU * q);
        others = TANGENTIAL + 8.0 * material.y * q + 2.0 * material.z * weave.w * q * q;
    } else if FIELDS == 2u {
        stretch = by_v * (q + TAU * m);
        others = TANGENTIAL + 8.0 * material.y * m + 2.0 * material.z * weave.z * m * m;
    } else if field == 3u {
        stretch *= TAU;
        others = NORMAL + 2.0 * TAU * material.x + BEND * bend;
    } else {
        others += bend + 4.0 * material.y * (m + q) + material.w;
    }
    return stretch + others / (h * w);
}

// Writes four columns of a row of the result, as far as they exist.
fn keep(field: u32, row: u32, column: u32, sum: vec4f) {
    if row >= params.rows || column >= params.columns {
        return;
    }
    var v = sum;
    if !INVERSE {
        v /= eigenvalues(field % FIELDS, row, column, cloths[field / FIELDS]);
    }
    let at = (field * params.rows + row) * params.columns + column;
    let columns = params.columns - column;
    out[at] = v.x;
    if columns > 1u { out[at + 1u] = v.y; }
    if columns > 2u { out[at + 2u] = v.z; }
    if columns > 3u { out[at + 3u] = v.w; }
}

@compute @workgroup_size(64)
fn cosine_columns(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let first_row = group.y * 32u;
    let first_column = group.x * 32u;
    let field = group.z * params.rows * params.columns;
    var sum0 = vec4f();
    var sum1 = vec4f();
    var sum2 = vec4f();
    var sum3 = vec4f();
    for (var first = 0u; first < params.rows; first += DEPTH) {
        workgroupBarrier();
        for (var k = lane; k < 8u * DEPTH; k += 64u) {
            // Neighbouring invocations read neighbouring elements. Those of the table are along its rows,
            // which are rows of the result only if it is transposed.
            let across = vec2u(k / 8u, k % 8u);
            let along = vec2u(k % DEPTH, k / DEPTH);
            let place = select(along, across, INVERSE);
            left[place.x * STRIDE + place.y] = quad_of_factors(first_row + 4u * place.y, first + place.x);
            let i = first + across.x;
            let j = first_column + 4u * across.y;
            right[across.x * STRIDE + across.y] = vec4f(
                element(field, i, j),
                element(field, i, j + 1u),
                element(field, i, j + 2u),
                element(field, i, j + 3u),
            );
        }
        workgroupBarrier();
        for (var k = 0u; k < DEPTH; k++) {
            let l = left[k * STRIDE + lane / 8u];
            let r = right[k * STRIDE + lane % 8u];
            sum0 += l.x * r;
            sum1 += l.y * r;
            sum2 += l.z * r;
            sum3 += l.w * r;
        }
    }
    let row = first_row + 4u * (lane / 8u);
    let column = first_column + 4u * (lane % 8u);
    keep(group.z, row, column, sum0);
    keep(group.z, row + 1u, column, sum1);
    keep(group.z, row + 2u, column, sum2);
    keep(group.z, row + 3u, column, sum3);
}
