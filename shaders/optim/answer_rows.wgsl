// The steps of a sheet in space and across its surface, and the cosine transform along the rows of what the latter leaves to be done along
// the surface.
//
// The inverse transform of the rows of z_0 to z_3, less what the reactions of handles take back (`rows_back`), is y_0 to y_3. With the step across
// d = -y_3 normal at free particles and 0 elsewhere,
//   rest = grad + sum over edges e at the particle of e (e . (d - d')), d' being the step at the other end,
//   z_(4 + f)[i, l] = sum_j table[l, j] field_f[i, j],
// where field 0 is the product of rest with t1 and field 1 that with t2, both 0 where no free particle is.
//
// table: [W, W], the orthonormal DCT-II
// marks: [B, H, W]
// axes: [B, 16, H, W] = t1, t2, the normal, near, the edge down, the edge to the right (`sheet_axes`)
// handles: [B, K], the handles that react, past the last one NONE
// reactions: [B, K, 4, H, W], in space, along t1 and t2, and across
// grad: [B, 3, H, W]
// z: [B, 6, H, W]
// y: [B, 6, H, W]; with MARGIN fields 4 and 5 are working space: y_3 in the rows before and after a workgroup's own
//
// With BACK and ANSWERS a workgroup has whole rows, and with a MARGIN of 1 it transforms those beside them, too, instead of waiting for others. Rows
// that are too long for that take two dispatches, one for either, without a MARGIN and with columns divided, too.
//
// One invocation per four columns of a row, all fields, or several. Workgroups: (1 or W / (32 TEAMS), H / (ROWS - 2 MARGIN), B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    room: u32, // K
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<f32>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> axes: array<f32>;
@group(0) @binding(4) var<storage, read> handles: array<u32>;
@group(0) @binding(5) var<storage, read> reactions: array<f32>;
@group(0) @binding(6) var<storage, read> grad: array<f32>;
@group(0) @binding(7) var<storage, read_write> z: array<f32>;
@group(0) @binding(8) var<storage, read_write> y: array<f32>;

const FIELDS: u32 = 4u;
const FIRST: u32 = 0u;

override BACK: bool = true;
override ANSWERS: bool = true;
// Rows before and after a workgroup's own that it transforms, 1 or 0.
override MARGIN: u32 = 1;
override OWN_ROWS: u32 = ROWS - 2u * MARGIN;

// Steps across at the particles that are multiplied at once and at those around them.
const BESIDE: u32 = DEPTH + 2u;
override AROUND: u32 = (OWN_ROWS + 2u) * BESIDE;
var<workgroup> steps: array<vec3f, AROUND>;

fn is_own(row: u32) -> bool {
    return row >= MARGIN && row + MARGIN < ROWS;
}

// Writes the fields of four columns of row i, as far as they exist; `row` in the tile.
fn keep_row(b: u32, row: u32, i: u32, column: u32) {
    if i >= params.rows || column >= params.columns {
        return;
    }
    let n = params.rows * params.columns;
    let at = 6u * b * n + i * params.columns + column;
    let columns = params.columns - column;
    if is_own(row) {
        keep_field(at, sum0, columns);
        keep_field(at + n, sum1, columns);
        keep_field(at + 2u * n, sum2, columns);
    }
    keep_field(at + field_across(row) * n, sum3, columns);
}

// Returns where the field across of a row in the tile is in y.
fn field_across(row: u32) -> u32 {
    if MARGIN == 0u {
        return 3u;
    }
    return select(select(3u, 5u, row + 1u == ROWS), 4u, row == 0u);
}

fn keep_field(at: u32, v: vec4f, columns: u32) {
    y[at] = v.x;
    if columns > 1u { y[at + 1u] = v.y; }
    if columns > 2u { y[at + 2u] = v.z; }
    if columns > 3u { y[at + 3u] = v.w; }
}

// Returns one of the axes or edges of a particle.
fn axis(b: u32, first: u32, p: u32) -> vec3f {
    let n = params.rows * params.columns;
    let at = (b * 16u + first) * n + p;
    return vec3f(axes[at], axes[at + n], axes[at + 2u * n]);
}

// Returns the step across at the particle in row i, `row` among the workgroup's own and those beside them, and the column after j, counted from
// one before the first; 0 where none is free. All is loaded before it is known whether it counts, so that loads don't wait for each other.
fn step_across(b: u32, row: u32, i: u32, after_j: u32) -> vec3f {
    let n = params.rows * params.columns;
    let j = clamp(after_j, 1u, params.columns) - 1u;
    let p = min(i, params.rows - 1u) * params.columns + j;
    let step = -y[(6u * b + field_across(row)) * n + p] * axis(b, 6u, p);
    let exists = i < params.rows && j + 1u == after_j;
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

// Adds the products over the stored depth of what is to be done along the surface.
fn add_answers(lane: u32) {
    let row = row_of(lane);
    let quad = place_of(quad_of(lane), 0u);
    for (var k = 0u; k < DEPTH; k++) {
        add_product_of_two(fields[k * STRIDE + row], factors[k * STRIDE_OF_FACTORS + quad]);
    }
}

@compute @workgroup_size(LANES)
fn answer_rows(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let b = group.z;
    let first_own = OWN_ROWS * group.y;
    let row = row_of(lane);
    // A row before the first one of all is past the last one.
    let i = first_own - MARGIN + row;
    let quad = quad_of(lane);
    // Not plainly a parameter (see `cosine_columns`), and the same for the whole workgroup, because of the barriers.
    let columns = params.columns + (group.z >> 31u);
    let own_columns = 32u * TEAMS * group.x;
    if BACK {
        for (var first = own_columns; first < columns; first += 32u * TEAMS * groups.x) {
            transform_back(b, lane, first_own - MARGIN, first);
            react_to_handles(b, lane, i, first + 4u * quad);
            keep_row(b, row, i, first + 4u * quad);
        }
    }
    // What follows reads what other invocations wrote.
    storageBarrier();
    if !ANSWERS {
        return;
    }
    for (var first_mode = own_columns; first_mode < columns; first_mode += 32u * TEAMS * groups.x) {
        clear_sums();
        for (var first = 0u; first < columns; first += DEPTH) {
            workgroupBarrier();
            for (var k = lane; k < AROUND; k += LANES) {
                steps[k] = step_across(b, k / BESIDE, first_own - 1u + k / BESIDE, first + k % BESIDE);
            }
            workgroupBarrier();
            // Neighbouring invocations read neighbouring elements of particles.
            for (var k = lane; k < OWN_ROWS * DEPTH; k += LANES) {
                let own = k / DEPTH;
                let depth = k % DEPTH;
                let place = depth * STRIDE + MARGIN + own;
                load_particle(b, first_own + own, first + depth, (own + 1u) * BESIDE + depth + 1u, place);
            }
            load_factors(lane, first, first_mode);
            workgroupBarrier();
            add_answers(lane);
        }
        let column = first_mode + 4u * quad;
        if is_own(row) && i < params.rows && column < params.columns {
            let n = params.rows * params.columns;
            let at = (6u * b + 4u) * n + i * params.columns + column;
            keep_modes(at, sum0, params.columns - column);
            keep_modes(at + n, sum1, params.columns - column);
        }
    }
}
