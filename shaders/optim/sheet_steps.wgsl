// The steps of a sheet whose handles hold: the spectral direction, and the co-rotated one, across the surface and along it.
//
// With the fields y of transforms that came back (`cosine_back`), and those of the reactions of the handles, at free particles
//   y'_f = y_f - sum_k reaction_kf y_f(handle_k)
//   direction 0 = -near (y'_0, y'_1, y'_2)
//   direction 1 = -(y'_3 normal + y'_4 t1 + y'_5 t2),
// and both are 0 elsewhere.
//
// marks: [B, n]
// axes: [B, 16, n] = t1, t2, the normal, near, and two edges (`sheet_axes`)
// y: [B, 6, n], in space, across, and along t1 and t2
// handles: [B, K], the handles that react, past the last one NONE
// reactions: [B, K, 4, n], in space, along t1 and t2, and across
// directions: [D, slot], of which slots 0 and 1 [B, 3, n] are written
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
fn sheet_steps(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.particles;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let b = group.z;
    if p >= n {
        return;
    }
    var in_space = vec3f();
    var in_sheet = vec3f();
    if is_free(marks[b * n + p]) {
        in_space = vec3f(reacted(b, 0u, 0u, p, n), reacted(b, 1u, 0u, p, n), reacted(b, 2u, 0u, p, n));
        in_sheet = vec3f(reacted(b, 4u, 1u, p, n), reacted(b, 5u, 2u, p, n), reacted(b, 3u, 3u, p, n));
    }
    let first = 16u * b * n + p;
    let near = axes[first + 9u * n];
    for (var c = 0u; c < 3u; c++) {
        let at = (3u * b + c) * n + p;
        let axis = first + c * n;
        let along = in_sheet.x * axes[axis] + in_sheet.y * axes[axis + 3u * n];
        directions[at] = -near * in_space[c];
        directions[params.slot + at] = -(along + in_sheet.z * axes[axis + 6u * n]);
    }
}
