// Between a field and the order in which a Fourier transform of it gives its cosine transform (Makhoul 1980): along each
// axis the even places ascending, then the odd ones descending.
//
// Forward v[b, c, i, j] = q[b, c, i', j'], backward (BACK) q[b, c, i', j'] = v[b, c, i, j]; handles are 0 in both, because
// they do not move. q: [B, 2, 3, H, W], of which the second half counts (see `lbfgs`); v: [3 B, H, W]; slots: [B, H W].
// One invocation: one element. Workgroups: (H W / 64 along x, then y, and 3 B).
// Adjoint: none, it is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> slots: array<u32>;
@group(0) @binding(2) var<storage, read_write> q: array<f32>;
@group(0) @binding(3) var<storage, read_write> v: array<f32>;

override BACK: bool = false;

// The place that comes `i`-th of `n`.
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
    let free = slots[cloth * n + p] == 0u;
    let at = (3u * (2u * cloth + 1u) + group.z % 3u) * n + p;
    let ordered = group.z * n + element;
    if BACK {
        q[at] = select(0.0, v[ordered], free);
    } else {
        v[ordered] = select(0.0, q[at], free);
    }
}
