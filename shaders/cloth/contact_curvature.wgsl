// Second derivatives of the contacts (`terms/contact`) along K directions p_0 ... p_(K-1), added to those of the other
// terms.
//
// With z the depth of a contact, q its gradient, n its normal, u its slip and w = u / |u| (0 below STICKING), it adds
//   6 z (q.p_i) (q.p_j) + mu P / max(|u|, STICKING) (p_i.p_j - (n.p_i) (n.p_j) - (w.p_i) (w.p_j))
// to A_ij = p_i . d2L/da2 p_j. The directions are 0 at handles.
//
// contacts: [B, SLOTS, n]
// a: [B, 3, n]
// given: base [B, 3, n], and more
// directions: [K, slot], [B, 3, n] each
// parts: [B, parts, 24], see `curvature`; the first ten numbers of each part are increased
//
// One invocation per particle. A workgroup takes every parts-th 64 of them, and adds to the part of its number. Sums have
// a fixed order.
// Workgroups: (parts, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    particles: u32, // n
    parts: u32,
    slot: u32, // elements from a direction to the next, at least 3 B n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> contacts: array<Contact>;
@group(0) @binding(2) var<storage, read> a: array<f32>;
@group(0) @binding(3) var<storage, read> given: array<f32>;
@group(0) @binding(4) var<storage, read> directions: array<f32>;
@group(0) @binding(5) var<storage, read_write> parts: array<vec4f>;

// Number of directions: 3 or 4.
override K: u32 = 3;
override SLOTS: u32 = 1;

@compute @workgroup_size(64)
fn contact_curvature(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.y;
    let n = params.particles;
    curvature0 = vec4f();
    curvature1 = vec4f();
    curvature2 = vec2f();
    for (var p = group.x * 64u + lane; p < n; p += params.parts * 64u) {
        for (var k = 0u; k < SLOTS; k++) {
            let one = contacts[(b * SLOTS + k) * n + p];
            if any(one.gradient != vec3f()) {
                let first = b * 3u * n + p;
                let px = of_directions(first);
                let py = of_directions(first + n);
                let pz = of_directions(first + 2u * n);
                add_contact(one, displacement(b, p, n), px, py, pz);
            }
        }
    }
    add_to_part(b, group.x, lane, 1.0);
}
