// Permutes a field into the order whose Fourier transform gives its cosine transform (Makhoul 1980), or back.
//
// Forward: v[b, c, i, j] = q[b, c, i', j'], with i' = place(i) and j' = place(j): along each axis the even
// indices in ascending order, then the odd ones in descending order.
// With BACK: q[b, c, i', j'] = v[b, c, i, j].
// It is 0 in either direction where no free particle is.
//
// marks: [B, H W]
// q: [B, 2, 3, H, W], of which the second half is used (see `lbfgs`)
// v: [3 B, H, W]
//
// One invocation per element. Workgroups: (H W / 64 over x and y, 3 B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read_write> q: array<f32>;
@group(0) @binding(3) var<storage, read_write> v: array<f32>;

override BACK: bool = false;

// Returns the index that comes `i`-th of `n`.
fn place(i: u32, n: u32) -> u32 {
    return select(2u * (n - i) - 1u, 2u * i, 2u * i < n);
}

@compute @workgroup_size(64)
fn cosine_order(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let element = (group.y * groups.x + group.x) * 64u + lane;
    if element >= n {
        return;
    }
    let row = place(element / params.columns, params.rows);
    let column = place(element % params.columns, params.columns);
    let p = row * params.columns + column;
    let cloth = group.z / 3u;
    let free = is_free(marks[cloth * n + p]);
    let at = (3u * (2u * cloth + 1u) + group.z % 3u) * n + p;
    let ordered = group.z * n + element;
    if BACK {
        q[at] = select(0.0, v[ordered], free);
    } else {
        v[ordered] = select(0.0, q[at], free);
    }
}
