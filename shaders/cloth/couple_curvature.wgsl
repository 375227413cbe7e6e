// Second derivatives of the couples (`couple`) along K directions p_0 ... p_(K-1), added to those of the other terms.
//
// With the part u of an edge e across the axis d of its couple, w = d x e, and the changes q_i of the edge along the
// directions, the edge after the particle adds
//   M ((u.q_i) (w.q_j) + (w.q_i) (u.q_j)) / |u|^4
// to A_ij = p_i . d2L/da2 p_j, and the edge before it the opposite. The directions are 0 at handles.
//
// cloths: [B]
// marks: [B, H, W]
// rest_angles: [B, H, W], along the height and along the width
// x, a: [B, 3, H, W]
// base: [B, 3, H, W], and more
// directions: [K, slot], [B, 3, H, W] each
// parts: [B, parts, 24], see `curvature`; the first ten numbers of each part are increased
//
// One invocation per particle. A workgroup takes every parts-th 64 of them, and adds to the part of its number. Sums have
// a fixed order.
// Workgroups: (parts, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    parts: u32,
    slot: u32, // elements from a direction to the next, at least 3 B H W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> rest_angles: array<vec2f>;
@group(0) @binding(4) var<storage, read> x: array<f32>;
@group(0) @binding(5) var<storage, read> a: array<f32>;
@group(0) @binding(6) var<storage, read> base: array<f32>;
@group(0) @binding(7) var<storage, read> directions: array<f32>;
@group(0) @binding(8) var<storage, read_write> parts: array<vec4f>;

// Number of directions: 3 or 4.
override K: u32 = 3;

// Adds what an edge from one particle to another one adds, given the elements of their first components.
fn add_edge(axis: vec3f, edge: vec3f, moment: f32, ends: vec2u) {
    let n = params.rows * params.columns;
    let arm = edge - dot(axis, edge) * axis;
    let across = cross(axis, edge);
    let inverse = 1.0 / max(dot(arm, arm), NEAREST);
    var of_arm = vec4f();
    var of_across = vec4f();
    for (var c = 0u; c < 3u; c++) {
        let change = of_directions(ends.y + c * n) - of_directions(ends.x + c * n);
        of_arm += arm[c] * change;
        of_across += across[c] * change;
    }
    of_arm *= moment * inverse * inverse;
    add_products(of_arm, of_across);
    add_products(of_across, of_arm);
}

@compute @workgroup_size(64)
fn couple_curvature(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.y;
    let n = params.rows * params.columns;
    curvature0 = vec4f();
    curvature1 = vec4f();
    curvature2 = vec2f();
    for (var p = group.x * 64u + lane; p < n; p += params.parts * 64u) {
        let own = vec2i(i32(p / params.columns), i32(p % params.columns));
        for (var axis = 0u; axis < 2u; axis++) {
            let one = hinge(b, own, axis);
            if one.moment != 0.0 {
                let at = b * 3u * n + p;
                let step = select(1u, params.columns, axis == 0u);
                add_edge(one.axis, one.before, -one.moment, vec2u(at - step, at));
                add_edge(one.axis, one.after, one.moment, vec2u(at, at + step));
            }
        }
    }
    add_to_part(b, group.x, lane, 1.0);
}
