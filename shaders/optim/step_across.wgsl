// The spectral direction, and the step across the surface of a sheet with what it leaves to be done along it.
//
// With the fields y [4] of a transform that came back (`cosine_back`), and those of the reactions of the handles, at free particles
//   y'_f = y_f - sum_k reaction_kf y_f(handle_k)
//   direction 0 = -near (y'_0, y'_1, y'_2)
//   direction 1 = -y'_3 normal
//   rest = grad + sum over edges e at the particle of e (e . (d - d')), d and d' being direction 1 there and at the other end,
// and all are 0 elsewhere.
//
// grad: [B, 3, n]
// marks: [B, n]
// axes: [B, 16, n] = t1, t2, the normal, near, the edge down, the edge to the right (`sheet_axes`)
// y: [B, 4, n]
// handles: [B, K], the handles that react, past the last one NONE
// reactions: [B, K, 4, n], in space, along t1 and t2, and across
// directions: [D, slot], of which slots 0 and 1 [B, 3, n] are written
// rest: [B, 3, n]
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    slot: u32, // elements from a direction to the next, at least 3 B n
    room: u32, // K
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> axes: array<f32>;
@group(0) @binding(4) var<storage, read> y: array<f32>;
@group(0) @binding(5) var<storage, read> handles: array<u32>;
@group(0) @binding(6) var<storage, read> reactions: array<f32>;
@group(0) @binding(7) var<storage, read_write> directions: array<f32>;
@group(0) @binding(8) var<storage, read_write> rest: array<f32>;

// Returns one of the axes or edges of a particle.
fn axis(b: u32, first: u32, p: u32) -> vec3f {
    let n = params.rows * params.columns;
    let at = (b * 16u + first) * n + p;
    return vec3f(axes[at], axes[at + n], axes[at + 2u * n]);
}

// Returns the step across at a particle, 0 where none is free.
fn across(b: u32, p: u32) -> vec3f {
    let n = params.rows * params.columns;
    if !is_free(marks[b * n + p]) {
        return vec3f();
    }
    return -reacted(b, (4u * b + 3u) * n, 3u, p, n) * axis(b, 6u, p);
}

// Returns the force on the first end of an edge from p to q, p being where it begins, for steps there.
fn answer(b: u32, edge: u32, p: u32, at_first: vec3f, at_other: vec3f) -> vec3f {
    let e = axis(b, edge, p);
    return e * dot(e, at_first - at_other);
}

@compute @workgroup_size(64)
fn step_across(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= n {
        return;
    }
    let b = group.z;
    let i = p / params.columns;
    let j = p % params.columns;
    let own = across(b, p);
    var force = vec3f();
    if i > 0u {
        let above = p - params.columns;
        force += answer(b, 10u, above, own, across(b, above));
    }
    if i + 1u < params.rows {
        force += answer(b, 10u, p, own, across(b, p + params.columns));
    }
    if j > 0u {
        force += answer(b, 13u, p - 1u, own, across(b, p - 1u));
    }
    if j + 1u < params.columns {
        force += answer(b, 13u, p, own, across(b, p + 1u));
    }
    let free = is_free(marks[b * n + p]);
    let near = axes[(b * 16u + 9u) * n + p];
    for (var c = 0u; c < 3u; c++) {
        let at = (3u * b + c) * n + p;
        directions[at] = select(0.0, -near * reacted(b, (4u * b + c) * n, 0u, p, n), free);
        directions[params.slot + at] = own[c];
        rest[at] = select(0.0, grad[at] + force[c], free);
    }
}
