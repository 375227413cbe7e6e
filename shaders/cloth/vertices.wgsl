// Vertices for rendering: position and smooth normal of every particle, at a time t between two frames.
//
//   position = A (x - (1 - t) v) + c, where [A | c] are the rows of the affine transform
//   normal = the unit vector along the sum of (q - p) x (r - p) over the triangles (p, q, r) of the cloth around p after
//     the transform, which is their area-weighted mean; zero if that sum is zero
//
// marks: [B, H, W]
// view: [B, 4, 4], the rows of [A | c], then (t, 0, 0, 0)
// x, v: [B, 3, H, W]
// interleaved: [B, H W, 6], position then normal
//
// One invocation per particle. Workgroups: (H W / 64 over x and y, B in z).
// Adjoint: none, rendering is not part of the training loss.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> view: array<vec4f>;
@group(0) @binding(3) var<storage, read> x: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read_write> interleaved: array<f32>;

// Returns the edge from the particle at element `at`, in row i and column j, to the one `down` rows and
// `right` columns away, after the linear part of the transform; zero if there is none.
fn edge(at: u32, i: i32, j: i32, down: i32, right: i32) -> vec3f {
    let inside = i + down >= 0 && i + down < i32(params.rows) && j + right >= 0 && j + right < i32(params.columns);
    if !inside {
        return vec3f();
    }
    let n = params.rows * params.columns;
    let other = u32(i32(at) + down * i32(params.columns) + right);
    // Differences of the positions and of the velocities are nearly exact; those of moved positions are not.
    let start = vec3f(x[other] - x[at], x[other + n] - x[at + n], x[other + 2u * n] - x[at + 2u * n]);
    let rate = vec3f(v[other] - v[at], v[other + n] - v[at + n], v[other + 2u * n] - v[at + 2u * n]);
    let rows = at / (3u * n) * 4u;
    let d = start - (1.0 - view[rows + 3u].x) * rate;
    return vec3f(dot(view[rows].xyz, d), dot(view[rows + 1u].xyz, d), dot(view[rows + 2u].xyz, d));
}

// Returns 1 if the cloth has the cell that begins `down` and `right` of particle (i, j) of cloth b, 0 or -1 each; else 0.
fn whole(b: u32, i: i32, j: i32, down: i32, right: i32) -> f32 {
    let row = i + down;
    let column = j + right;
    if row < 0 || column < 0 {
        return 0.0;
    }
    let a = b * params.rows * params.columns + u32(row) * params.columns + u32(column);
    return select(0.0, 1.0, begins_cell(marks[a]));
}

@compute @workgroup_size(64)
fn vertices(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let n = params.rows * params.columns;
    if p >= n {
        return;
    }
    let at = group.z * 3u * n + p;
    let i = i32(p / params.columns);
    let j = i32(p % params.columns);
    let back = 1.0 - view[4u * group.z + 3u].x;
    let moved = vec4f(x[at] - back * v[at], x[at + n] - back * v[at + n], x[at + 2u * n] - back * v[at + 2u * n], 1.0);
    // The fan of triangles around p: cells are cut along the diagonal from (i, j) to (i + 1, j + 1).
    let below = edge(at, i, j, 1, 0);
    let below_right = edge(at, i, j, 1, 1);
    let right = edge(at, i, j, 0, 1);
    let above = edge(at, i, j, -1, 0);
    let above_left = edge(at, i, j, -1, -1);
    let left = edge(at, i, j, 0, -1);
    let b = group.z;
    let after = whole(b, i, j, 0, 0);
    let before = whole(b, i, j, -1, -1);
    let sum = after * (cross(below, below_right) + cross(below_right, right))
        + whole(b, i, j, -1, 0) * cross(right, above)
        + before * (cross(above, above_left) + cross(above_left, left))
        + whole(b, i, j, 0, -1) * cross(left, below);
    // Scaled first, so that no square underflows.
    let size = max(max(abs(sum.x), abs(sum.y)), abs(sum.z));
    var normal = vec3f();
    if size > 0.0 {
        normal = normalize(sum / size);
    }
    let to = 6u * (group.z * n + p);
    for (var c = 0u; c < 3u; c++) {
        interleaved[to + c] = dot(view[4u * group.z + c], moved);
        interleaved[to + 3u + c] = normal[c];
    }
}
