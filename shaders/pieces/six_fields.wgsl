
// A product of six fields with a matrix, in tiles of 8 rows of particles by 32 columns of the result. An
// invocation computes four columns of one row, for all six fields: each number that it reads from workgroup
// memory then enters at least four products.

// Particles of a row, and rows of the matrix, that are multiplied at once.
const DEPTH: u32 = 16u;
// Both are stored by depth. One more than needed, so that neighbours in depth are in different banks.
const STRIDE: u32 = 9u;
// Fields 0 to 2 and 3 to 5 of the particles.
var<workgroup> firsts: array<vec3f, DEPTH * STRIDE>;
var<workgroup> lasts: array<vec3f, DEPTH * STRIDE>;
// Four columns of a row of the matrix.
var<workgroup> factors: array<vec4f, DEPTH * STRIDE>;

// Four columns of the result for each field.
var<private> sum0: vec4f;
var<private> sum1: vec4f;
var<private> sum2: vec4f;
var<private> sum3: vec4f;
var<private> sum4: vec4f;
var<private> sum5: vec4f;

// Adds the products over the stored depth, for this row of the tile and this quad of its columns.
fn add_products(row: u32, quad: u32) {
    for (var k = 0u; k < DEPTH; k++) {
        let factor = factors[k * STRIDE + quad];
        let first = firsts[k * STRIDE + row];
        let last = lasts[k * STRIDE + row];
        sum0 += first.x * factor;
        sum1 += first.y * factor;
        sum2 += first.z * factor;
        sum3 += last.x * factor;
        sum4 += last.y * factor;
        sum5 += last.z * factor;
    }
}
