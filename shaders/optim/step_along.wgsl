// The step along the surface of a sheet that answers the one across it (`step_across`), and with it is the co-rotated direction.
//
// With the fields y [2] of a transform that came back (`cosine_back`), and those of the reactions of the handles, at free particles
//   y'_f = y_f - sum_k reaction_kf y_f(handle_k)
//   direction 1 -= y'_0 t1 + y'_1 t2
//
// marks: [B, n]
// axes: [B, 16, n] = t1, t2, the normal, near, and two edges (`sheet_axes`)
// y: [B, 2, n]
// handles: [B, K], the handles that react, past the last one NONE
// reactions: [B, K, 4, n], in space, along t1 and t2, and across
// directions: [D, slot], of which slot 1 [B, 3, n] is changed
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    particles: u32, // n
    slot: u32, // elements from a direction to the next, at least 3 B n
    room: u32, // K
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> axes: array<f32>;
@group(0) @binding(3) var<storage, read> y: array<f32>;
@group(0) @binding(4) var<storage, read> handles: array<u32>;
@group(0) @binding(5) var<storage, read> reactions: array<f32>;
@group(0) @binding(6) var<storage, read_write> directions: array<f32>;

@compute @workgroup_size(64)
fn step_along(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.particles;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let b = group.z;
    if p >= n || !is_free(marks[b * n + p]) {
        return;
    }
    let first = reacted(b, 2u * b * n, 1u, p, n);
    let second = reacted(b, (2u * b + 1u) * n, 2u, p, n);
    for (var c = 0u; c < 3u; c++) {
        let axis = (b * 16u + c) * n + p;
        let at = params.slot + (3u * b + c) * n + p;
        directions[at] -= first * axes[axis] + second * axes[axis + 3u * n];
    }
}
