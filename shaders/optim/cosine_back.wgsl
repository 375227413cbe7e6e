// Inverse cosine transform along the rows of the fields of a sheet, less what the reactions of its handles take back; of those along the
// surface the steps that all of them make.
//
//   y_f[i, j] = sum_l table[l, j] z[f, i, l],  y'_f = y_f - sum_k reaction_kf y_f(handle_k)
// Of four fields, in space and across the surface, out = y'. Of two, y'_4 and y'_5 along t1 and t2, with those of out, at free particles
//   direction 0 = -near (y'_0, y'_1, y'_2)
//   direction 1 = -(y'_3 normal + y'_4 t1 + y'_5 t2),
// and both are 0 elsewhere.
//
// table: [W, W], the orthonormal DCT-II
// z: [B, FIELDS, H, W]
// marks: [B, H, W]
// axes: [B, 16, H, W] = t1, t2, the normal, near, and two edges (`sheet_axes`)
// handles: [B, K], the handles that react, past the last one NONE
// reactions: [B, K, 4, H, W], in space, along t1 and t2, and across
// out: [B, 6, H, W], of which fields 0 to 3 are written, or read
// directions: [D, slot], of which slots 0 and 1 [B, 3, H, W] are written by the two fields
//
// One invocation per four columns of a row, all fields. Workgroups: (W / 32, H / 8, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    room: u32, // K
    slot: u32, // elements from a direction to the next, at least 3 B H W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<f32>;
@group(0) @binding(2) var<storage, read> z: array<f32>;
@group(0) @binding(3) var<storage, read> marks: array<vec2u>;
@group(0) @binding(4) var<storage, read> axes: array<f32>;
@group(0) @binding(5) var<storage, read> handles: array<u32>;
@group(0) @binding(6) var<storage, read> reactions: array<f32>;
@group(0) @binding(7) var<storage, read_write> out: array<f32>;
@group(0) @binding(8) var<storage, read_write> directions: array<f32>;

// Stands for a handle that there isn't.
const NONE: u32 = 0xffffffffu;

// The fields at two handles, in 32 sums each.
var<workgroup> at_handles: array<vec4f, 64>;

// Returns the fields of a mode, 0 if there is none.
fn mode(b: u32, i: u32, l: u32) -> vec4f {
    let n = params.rows * params.columns;
    var of_mode = vec4f();
    if i < params.rows && l < params.columns {
        let at = b * FIELDS * n + i * params.columns + l;
        of_mode.x = z[at];
        of_mode.y = z[at + n];
        if FIELDS > 2u {
            of_mode.z = z[at + 2u * n];
            of_mode.w = z[at + 3u * n];
        }
    }
    return of_mode;
}

// Returns row l of four columns of the table from column j on.
fn quad_along(l: u32, j: u32) -> vec4f {
    return vec4f(cosine(l, j), cosine(l, j + 1u), cosine(l, j + 2u), cosine(l, j + 3u));
}

// The reaction of a handle at four columns of a row, in space or along t1, and across or along t2.
struct Reaction {
    first: vec4f,
    second: vec4f,
}

// Returns the reaction of handle k at four columns from column j on of row i, those of the last row and column past them.
fn reaction(k: u32, i: u32, j: u32) -> Reaction {
    let components = select(vec2u(1u, 2u), vec2u(0u, 3u), FIELDS > 2u);
    return Reaction(of_component(4u * k + components.x, i, j), of_component(4u * k + components.y, i, j));
}

fn of_component(component: u32, i: u32, j: u32) -> vec4f {
    let row = (component * params.rows + min(i, params.rows - 1u)) * params.columns;
    let last = params.columns - 1u;
    return vec4f(
        reactions[row + min(j, last)],
        reactions[row + min(j + 1u, last)],
        reactions[row + min(j + 2u, last)],
        reactions[row + min(j + 3u, last)],
    );
}

// Takes the reaction of a handle back, given the fields there.
fn react(to: Reaction, at_handle: vec4f) {
    sum0 -= at_handle.x * to.first;
    if FIELDS > 2u {
        sum1 -= at_handle.y * to.first;
        sum2 -= at_handle.z * to.first;
        sum3 -= at_handle.w * to.second;
    } else {
        sum1 -= at_handle.y * to.second;
    }
}

// Takes the reactions of all handles of a cloth back. Each workgroup transforms their fields for itself, those of two at a time. What does not
// wait for them is loaded before.
fn react_to_handles(b: u32, lane: u32, i: u32, j: u32) {
    let end = (b + 1u) * params.room;
    // Not plainly a parameter: see `cosine_columns`.
    let columns = params.columns + (lane >> 31u);
    for (var k = b * params.room; k < end && handles[k] != NONE; k += 2u) {
        let next = min(k + 1u, end - 1u);
        let has_next = k + 1u < end && handles[next] != NONE;
        let first = reaction(k, i, j);
        let second = reaction(next, i, j);
        let handle = min(handles[select(k, next, lane >= 32u)], params.rows * params.columns - 1u);
        var sum = vec4f();
        for (var l = lane % 32u; l < columns; l += 32u) {
            sum += cosine(l, handle % params.columns) * mode(b, handle / params.columns, l);
        }
        workgroupBarrier();
        at_handles[lane] = sum;
        for (var half = 16u; half > 0u; half /= 2u) {
            workgroupBarrier();
            if lane % 32u < half {
                at_handles[lane] += at_handles[lane + half];
            }
        }
        workgroupBarrier();
        react(first, at_handles[0]);
        if has_next {
            react(second, at_handles[32]);
        }
    }
}

// Writes both directions at a particle, given its fields along t1 and t2. All is loaded before it is known whether it is free, so that loads don't
// wait for each other.
fn keep_steps(b: u32, p: u32, first_tangent: f32, second_tangent: f32) {
    let n = params.rows * params.columns;
    let at = 6u * b * n + p;
    let in_space = vec3f(out[at], out[at + n], out[at + 2u * n]);
    let across = out[at + 3u * n];
    let first = 16u * b * n + p;
    let near = axes[first + 9u * n];
    let is_free_here = is_free(marks[b * n + p]);
    for (var c = 0u; c < 3u; c++) {
        let to = (3u * b + c) * n + p;
        let axis = first + c * n;
        let along = first_tangent * axes[axis] + second_tangent * axes[axis + 3u * n];
        directions[to] = select(0.0, -near * in_space[c], is_free_here);
        directions[params.slot + to] = select(0.0, -(along + across * axes[axis + 6u * n]), is_free_here);
    }
}

@compute @workgroup_size(64)
fn cosine_back(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let first_row = group.y * 8u;
    let first_column = group.x * 32u;
    let i = first_row + lane / 8u;
    let j = first_column + 4u * (lane % 8u);
    if STAGED {
        for (var first = 0u; first < params.columns; first += DEPTH) {
            workgroupBarrier();
            // Neighbouring invocations read neighbouring elements of z and of the table.
            for (var k = lane; k < 8u * DEPTH; k += 64u) {
                fields[k % DEPTH * STRIDE + k / DEPTH] = mode(b, first_row + k / DEPTH, first + k % DEPTH);
                factors[k / 8u * STRIDE + k % 8u] = quad_along(first + k / 8u, first_column + 4u * (k % 8u));
            }
            workgroupBarrier();
            add_products(lane / 8u, lane % 8u);
        }
    } else {
        // Not plainly a parameter: see `cosine_columns`.
        let columns = params.columns + (lane >> 31u);
        for (var l = 0u; l < columns; l++) {
            add_product(mode(b, i, l), quad_along(l, j));
        }
    }
    react_to_handles(b, lane, i, j);
    if FIELDS > 2u {
        keep_fields(6u * b, i, j);
        return;
    }
    if i < params.rows && j < params.columns {
        let p = i * params.columns + j;
        let columns = params.columns - j;
        keep_steps(b, p, sum0.x, sum1.x);
        if columns > 1u { keep_steps(b, p + 1u, sum0.y, sum1.y); }
        if columns > 2u { keep_steps(b, p + 2u, sum0.z, sum1.z); }
        if columns > 3u { keep_steps(b, p + 3u, sum0.w, sum1.w); }
    }
}
