// The steps of a sheet, from the transforms of the rows of its fields along the surface: the inverse transform, less what the reactions of
// its handles take back (`rows_back`), is y_4 and y_5, along t1 and t2. With the other fields, of which this was done before
// (`answer_rows`), at free particles
//   direction 0 = -near (y_0, y_1, y_2)
//   direction 1 = -(y_3 normal + y_4 t1 + y_5 t2),
// and both are 0 elsewhere.
//
// table: [W, W], the orthonormal DCT-II
// z: [B, 6, H, W], of which fields 4 and 5 are read
// marks: [B, H, W]
// axes: [B, 16, H, W] = t1, t2, the normal, near, and two edges (`sheet_axes`)
// handles: [B, K], the handles that react, past the last one NONE
// reactions: [B, K, 4, H, W], in space, along t1 and t2, and across
// y: [B, 6, H, W], of which fields 0 to 3 are read
// directions: [D, slot], of which slots 0 and 1 [B, 3, H, W] are written
//
// One invocation per four columns of a row, both fields. Workgroups: (W / 32, H / 8, B).
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
@group(0) @binding(7) var<storage, read> y: array<f32>;
@group(0) @binding(8) var<storage, read_write> directions: array<f32>;

const FIELDS: u32 = 2u;
const FIRST: u32 = 4u;

// Writes both directions at a particle, given its fields along t1 and t2. All is loaded before it is known whether it is free, so that loads don't
// wait for each other.
fn keep_steps(b: u32, p: u32, first_tangent: f32, second_tangent: f32) {
    let n = params.rows * params.columns;
    let at = 6u * b * n + p;
    let in_space = vec3f(y[at], y[at + n], y[at + 2u * n]);
    let across = y[at + 3u * n];
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

@compute @workgroup_size(LANES)
fn sheet_steps(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let i = group.y * 8u + row_of(lane);
    let j = group.x * 32u + 4u * quad_of(lane);
    transform_back(b, lane, group.y * 8u, group.x * 32u);
    react_to_handles(b, lane, i, j);
    if i < params.rows && j < params.columns {
        let p = i * params.columns + j;
        let columns = params.columns - j;
        keep_steps(b, p, sum0.x, sum1.x);
        if columns > 1u { keep_steps(b, p + 1u, sum0.y, sum1.y); }
        if columns > 2u { keep_steps(b, p + 2u, sum0.z, sum1.z); }
        if columns > 3u { keep_steps(b, p + 3u, sum0.w, sum1.w); }
    }
}
