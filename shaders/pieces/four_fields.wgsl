// A product of four fields, or two, with a matrix, in tiles of 8 rows of particles by 32 columns of the result. An
// invocation computes four columns of one row, for all fields: each number that it reads from workgroup
// memory, or from the tensors if they are not STAGED there, then enters several products. From the kernel's bindings table and out, and parameters rows and columns.

// 4, or 2: then the other two are neither read nor written.
override FIELDS: u32 = 4;
// Whether particles and matrix go through workgroup memory. On software adapters the barriers cost more than that saves.
override STAGED: bool = true;

// Particles of a row, and rows of the matrix, that are multiplied at once.
const DEPTH: u32 = 16u;
// Both are stored by depth. One more than needed, so that neighbours in depth are in different banks.
const STRIDE: u32 = 9u;
// The fields of the particles.
var<workgroup> fields: array<vec4f, DEPTH * STRIDE>;
// Four columns of a row of the matrix.
var<workgroup> factors: array<vec4f, DEPTH * STRIDE>;

// Four columns of the result for each field.
var<private> sum0: vec4f;
var<private> sum1: vec4f;
var<private> sum2: vec4f;
var<private> sum3: vec4f;

// Adds the products of the fields of a particle and four columns of a row of the matrix.
fn add_product(of_particle: vec4f, factor: vec4f) {
    sum0 += of_particle.x * factor;
    sum1 += of_particle.y * factor;
    if FIELDS > 2u {
        sum2 += of_particle.z * factor;
        sum3 += of_particle.w * factor;
    }
}

// Adds the products over the stored depth, for this row of the tile and this quad of its columns.
fn add_products(row: u32, quad: u32) {
    for (var k = 0u; k < DEPTH; k++) {
        add_product(fields[k * STRIDE + row], factors[k * STRIDE + quad]);
    }
}

// Returns element (l, j) of the kernel's table [W, W], of the last row or column past them: there all fields are 0, or nothing is
// written.
fn cosine(l: u32, j: u32) -> f32 {
    return table[min(l, params.columns - 1u) * params.columns + min(j, params.columns - 1u)];
}

// Returns column j of four rows of the table from row l on.
fn quad_of_cosines(l: u32, j: u32) -> vec4f {
    return vec4f(cosine(l, j), cosine(l + 1u, j), cosine(l + 2u, j), cosine(l + 3u, j));
}

// Writes the columns of a quad that exist to the kernel's out.
fn keep(at: u32, v: vec4f, columns: u32) {
    if columns > 0u { out[at] = v.x; }
    if columns > 1u { out[at + 1u] = v.y; }
    if columns > 2u { out[at + 2u] = v.z; }
    if columns > 3u { out[at + 3u] = v.w; }
}

// Writes four columns of row i of all fields of a cloth, as far as they exist, given the place of its first field in the kernel's out.
fn keep_fields(first: u32, i: u32, column: u32) {
    if i >= params.rows || column >= params.columns {
        return;
    }
    let n = params.rows * params.columns;
    let at = first * n + i * params.columns + column;
    let columns = params.columns - column;
    keep(at, sum0, columns);
    keep(at + n, sum1, columns);
    if FIELDS > 2u {
        keep(at + 2u * n, sum2, columns);
        keep(at + 3u * n, sum3, columns);
    }
}
