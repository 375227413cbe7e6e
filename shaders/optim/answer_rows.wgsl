// Cosine transform along the rows of what a step across the surface of a sheet leaves to be done along it.
//
// With the step across d = -y_3 normal at free particles and 0 elsewhere,
//   rest = grad + sum over edges e at the particle of e (e . (d - d')), d' being the step at the other end,
//   out[f, i, l] = sum_j table[l, j] field_f[i, j],
// where field 0 is the product of rest with t1 and field 1 that with t2, both 0 where no free particle is.
//
// grad: [B, 3, H, W]
// marks: [B, H, W]
// axes: [B, 16, H, W] = t1, t2, the normal, near, the edge down, the edge to the right (`sheet_axes`)
// table: [W, W], the orthonormal DCT-II
// y: [B, 6, H, W], whose field 3 came back from a transform (`cosine_back`)
// out: [B, 2, H, W]
//
// One invocation per four columns of a row, both fields. Workgroups: (W / 32, H / 8, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> axes: array<f32>;
@group(0) @binding(4) var<storage, read> table: array<f32>;
@group(0) @binding(5) var<storage, read> y: array<f32>;
@group(0) @binding(6) var<storage, read_write> out: array<f32>;

// Steps across at the particles that are multiplied at once and at those around them.
const BESIDE: u32 = DEPTH + 2u;
var<workgroup> steps: array<vec3f, 10u * BESIDE>;

// Returns one of the axes or edges of a particle.
fn axis(b: u32, first: u32, p: u32) -> vec3f {
    let n = params.rows * params.columns;
    let at = (b * 16u + first) * n + p;
    return vec3f(axes[at], axes[at + n], axes[at + 2u * n]);
}

// Returns the step across at the particle in the row after i and the column after j, counted from one before the first; 0 where none is free.
// All is loaded before it is known whether it counts, so that loads don't wait for each other.
fn step_across(b: u32, after_i: u32, after_j: u32) -> vec3f {
    let n = params.rows * params.columns;
    let i = clamp(after_i, 1u, params.rows) - 1u;
    let j = clamp(after_j, 1u, params.columns) - 1u;
    let p = i * params.columns + j;
    let step = -y[(6u * b + 3u) * n + p] * axis(b, 6u, p);
    let exists = i + 1u == after_i && j + 1u == after_j;
    return select(vec3f(), step, exists && is_free(marks[b * n + p]));
}

// Returns the force of an edge that begins at p, for the difference of the steps at its ends.
fn answer(b: u32, edge: u32, p: u32, difference: vec3f) -> vec3f {
    let e = axis(b, edge, p);
    return e * dot(e, difference);
}

// Stores the fields of particle (i, j), whose step is at `own` of the stored ones; 0 if there is none.
fn load_particle(b: u32, i: u32, j: u32, own: u32, place: u32) {
    let n = params.rows * params.columns;
    let p = i * params.columns + j;
    var of_particle = vec4f();
    if i < params.rows && j < params.columns {
        let at = b * 3u * n + p;
        let mark = marks[b * n + p];
        var rest = vec3f(grad[at], grad[at + n], grad[at + 2u * n]);
        let d = steps[own];
        if i > 0u {
            rest += answer(b, 10u, p - params.columns, d - steps[own - BESIDE]);
        }
        if i + 1u < params.rows {
            rest += answer(b, 10u, p, d - steps[own + BESIDE]);
        }
        if j > 0u {
            rest += answer(b, 13u, p - 1u, d - steps[own - 1u]);
        }
        if j + 1u < params.columns {
            rest += answer(b, 13u, p, d - steps[own + 1u]);
        }
        let along = vec4f(dot(axis(b, 0u, p), rest), dot(axis(b, 3u, p), rest), 0.0, 0.0);
        of_particle = select(vec4f(), along, is_free(mark));
    }
    fields[place] = of_particle;
}

@compute @workgroup_size(64)
fn answer_rows(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let first_row = group.y * 8u;
    let first_column = group.x * 32u;
    // Not plainly a parameter (see `cosine_columns`), and the same for the whole workgroup, because of the barriers.
    let columns = params.columns + (group.z >> 31u);
    for (var first = 0u; first < columns; first += DEPTH) {
        workgroupBarrier();
        for (var k = lane; k < 10u * BESIDE; k += 64u) {
            steps[k] = step_across(b, first_row + k / BESIDE, first + k % BESIDE);
        }
        workgroupBarrier();
        // Neighbouring invocations read neighbouring elements of particles and table.
        for (var k = lane; k < 8u * DEPTH; k += 64u) {
            let depth = k % DEPTH;
            let other = k / DEPTH;
            let own = (other + 1u) * BESIDE + depth + 1u;
            load_particle(b, first_row + other, first + depth, own, depth * STRIDE + other);
            factors[depth * STRIDE + other] = quad_of_cosines(first_column + 4u * other, first + depth);
        }
        workgroupBarrier();
        add_products(lane / 8u, lane % 8u);
    }
    keep_fields(2u * b, first_row + lane / 8u, first_column + 4u * (lane % 8u));
}
