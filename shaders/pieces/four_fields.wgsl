// A product of four fields, or two, with a matrix, in a tile of ROWS of particles by 32 columns of the result for each team of
// invocations. An invocation computes four columns of one row, for all fields: each number that it reads from workgroup
// memory, or from the tensors if they are not STAGED there, then enters several products. From the kernel's binding table, its constant FIELDS
// (4, or 2: then the other two are neither read nor written), and parameters rows and columns.

// At least 8.
override ROWS: u32 = 8;
// Teams of a workgroup: they share the particles, and each has columns of its own.
override TEAMS: u32 = 1;
override LANES: u32 = 8u * ROWS * TEAMS;
// Whether particles and matrix go through workgroup memory. On software adapters the barriers cost more than that saves.
override STAGED: bool = true;

// Particles of a row, and rows of the matrix, that are multiplied at once.
const DEPTH: u32 = 16u;
// Both are stored by depth. One more than needed, so that neighbours in depth are in different banks.
override STRIDE: u32 = ROWS + 1u;
const STRIDE_OF_FACTORS: u32 = 9u;
// The fields of the particles.
override FIELDS_AT_ONCE: u32 = DEPTH * STRIDE;
var<workgroup> fields: array<vec4f, FIELDS_AT_ONCE>;
// Four columns of a row of the matrix, team by team.
override FACTORS: u32 = TEAMS * DEPTH * STRIDE_OF_FACTORS;
var<workgroup> factors: array<vec4f, FACTORS>;

// Four columns of the result for each field.
var<private> sum0: vec4f;
var<private> sum1: vec4f;
var<private> sum2: vec4f;
var<private> sum3: vec4f;

fn clear_sums() {
    sum0 = vec4f();
    sum1 = vec4f();
    sum2 = vec4f();
    sum3 = vec4f();
}

// Returns the row of an invocation in the tile of its workgroup, and the quad of columns.
fn row_of(lane: u32) -> u32 {
    return lane / 8u % ROWS;
}

fn quad_of(lane: u32) -> u32 {
    return lane / (8u * ROWS) * 8u + lane % 8u;
}

// Returns the place of a quad of columns in the factors.
fn place_of(quad: u32, depth: u32) -> u32 {
    return (quad / 8u * DEPTH + depth) * STRIDE_OF_FACTORS + quad % 8u;
}

// Adds the products of the fields of a particle and four columns of a row of the matrix.
fn add_product(of_particle: vec4f, factor: vec4f) {
    add_product_of_two(of_particle, factor);
    if FIELDS > 2u {
        sum2 += of_particle.z * factor;
        sum3 += of_particle.w * factor;
    }
}

fn add_product_of_two(of_particle: vec4f, factor: vec4f) {
    sum0 += of_particle.x * factor;
    sum1 += of_particle.y * factor;
}

// Adds the products over the stored depth, for the row and the quad of an invocation.
fn add_products(lane: u32) {
    let row = row_of(lane);
    let quad = place_of(quad_of(lane), 0u);
    for (var k = 0u; k < DEPTH; k++) {
        add_product(fields[k * STRIDE + row], factors[k * STRIDE_OF_FACTORS + quad]);
    }
}

// Returns element (l, j) of the kernel's table [W, W], of the last row or column past them: there all fields are 0, or nothing is
// written.
fn cosine(l: u32, j: u32) -> f32 {
    return table[min(l, params.columns - 1u) * params.columns + min(j, params.columns - 1u)];
}
