// Contacts of the particles with bodies (`terms/contact`): the acceleration that they add to the external one, and their
// energy in partial sums over the particles of a cloth.
//
// marks: [B, n]
// contacts: [B, SLOTS, n]
// a: [B, 3, n]
// given: base [B, 3, n]; the accelerations without the contacts [B, 3, n] from element `first_source` on, and those with
//   them from `first_total` on, which may be the same
// parts: [B, groups, 8], of which the last number is increased, or with SETS set
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no bodies.

struct Params {
    rows: u32, // H
    columns: u32, // W
    groups: u32,
    first_source: u32,
    first_total: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> contacts: array<Contact>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read_write> given: array<f32>;
@group(0) @binding(5) var<storage, read_write> parts: array<f32>;

override SLOTS: u32 = 1;
override SETS: bool = true;

@compute @workgroup_size(64)
fn contact(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let part = group.y * groups.x + group.x;
    let p = part * 64u + lane;
    let b = group.z;
    var energy = 0.0;
    if p < n {
        let y = displacement(b, p, n);
        var gradient = vec3f();
        for (var k = 0u; k < SLOTS; k++) {
            let one = contacts[(b * SLOTS + k) * n + p];
            if any(one.gradient != vec3f()) {
                energy += contact_energy(one, y);
                gradient += contact_gradient(one, y);
            }
        }
        // Only free particles have contacts.
        let added = accelerated(-gradient, marks[b * n + p], n);
        let at = b * 3u * n + p;
        for (var c = 0u; c < 3u; c++) {
            given[params.first_total + at + c * n] = given[params.first_source + at + c * n] + added[c];
        }
    }
    put_energy(b, part, lane, energy);
}
