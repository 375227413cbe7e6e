// What each pair of parts of a cloth does at the current accelerations (`terms/contact`): the derivative of its energy with
// respect to the relative displacement, and the energy. Instead of that where to move them, over the sum of the weights times
// what a force accelerates their particles by, and 1; zeros where they may stay. With MOVES 1 they leave what is nearer than
// LEAST_GAP of the thickness, with 2 those that stick take back their slip.
//
// marks: [B, n]
// pair_ends: [B, buckets]
// pairs: [B, room]
// a: [B, 3, n]
// given: base [B, 3, n], and more
// presses: [B, room]
//
// One invocation per particle; they stride over the pairs. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no self-contact.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    room: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_ends: array<u32>;
@group(0) @binding(3) var<storage, read> pairs: array<Pair>;
@group(0) @binding(4) var<storage, read> a: array<f32>;
@group(0) @binding(5) var<storage, read> given: array<f32>;
@group(0) @binding(6) var<storage, read_write> presses: array<vec4f>;

override MOVES: u32 = 0;

@compute @workgroup_size(64)
fn layer_press(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let b = group.z;
    let count = pairs_of(b);
    let n = params.rows * params.columns;
    for (var k = (group.y * groups.x + group.x) * 64u + lane; k < count; k += groups.x * groups.y * 64u) {
        let pair = pairs[b * params.room + k];
        let y = across(b, pair);
        var press = vec4f();
        if MOVES != 0u {
            var way = vec3f();
            if MOVES == 1u {
                way = contact_way_out(pair.contact, y);
            } else {
                way = contact_slip_back(pair.contact, y);
            }
            if any(way != vec3f()) {
                var sum = 0.0;
                for (var corner = 0u; corner < 4u; corner++) {
                    let p = pair.particles[corner];
                    if (p & HELD) == 0u {
                        sum += pair.weights[corner] * pair.weights[corner] * f32(n) / mass_of(marks[b * n + p]);
                    }
                }
                press = vec4f(way / sum, 1.0);
            }
        } else {
            press = vec4f(contact_gradient(pair.contact, y), contact_energy(pair.contact, y));
        }
        presses[b * params.room + k] = press;
    }
}
