// Second derivatives of the pairs of parts of a cloth (`terms/contact`) along K directions p_0 ... p_(K-1), added to those
// of the other terms as `contact_curvature` does, with what the directions move the parts by relative to each other. The
// directions are 0 at handles.
//
// pair_ends: [B, buckets]
// pairs: [B, room]
// a: [B, 3, n]
// given: base [B, 3, n], and more
// directions: [K, slot], [B, 3, n] each
// parts: [B, parts, 24], see `curvature`; the first ten numbers of each part are increased
//
// One workgroup per part, whose invocations stride over the pairs. Sums have a fixed order.
// Workgroups: (parts, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    room: u32,
    parts: u32,
    slot: u32, // elements from a direction to the next, at least 3 B n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pair_ends: array<u32>;
@group(0) @binding(2) var<storage, read> pairs: array<Pair>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> given: array<f32>;
@group(0) @binding(5) var<storage, read> directions: array<f32>;
@group(0) @binding(6) var<storage, read_write> parts: array<vec4f>;

// Number of directions: 3 or 4.
override K: u32 = 3;

@compute @workgroup_size(64)
fn layer_curvature(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.y;
    let n = params.rows * params.columns;
    let count = pairs_of(b);
    curvature0 = vec4f();
    curvature1 = vec4f();
    curvature2 = vec2f();
    for (var k = group.x * 64u + lane; k < count; k += params.parts * 64u) {
        let pair = pairs[b * params.room + k];
        let y = across(b, pair);
        if pair.contact.friction > 0.0 || contact_depth(pair.contact, y) > 0.0 {
            var px = vec4f();
            var py = vec4f();
            var pz = vec4f();
            for (var corner = 0u; corner < 4u; corner++) {
                let at = b * 3u * n + (pair.particles[corner] & ~HELD);
                px += pair.weights[corner] * of_directions(at);
                py += pair.weights[corner] * of_directions(at + n);
                pz += pair.weights[corner] * of_directions(at + 2u * n);
            }
            add_contact(pair.contact, y, px, py, pz);
        }
    }
    add_to_part(b, group.x, lane, 1.0);
}
