// The forces between layers of a cloth: the acceleration that they add to the external one, and their energy in partial sums
// over the particles of a cloth. The energy of a pair counts at its first particle.
//
// marks: [B, n]
// ends: [B, buckets], where the list of each particle ends
// corners: [B, 4 room], see `layer_list`
// pairs: [B, room]
// presses: [B, room], see `layer_press`
// given: the accelerations without these forces [B, 3, n] from element `first_source` on, and those with them from
//   `first_total` on, which may be the same
// parts: [B, groups, 8], of which the last number is increased, or with SETS set
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no self-contact.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    room: u32,
    groups: u32,
    first_source: u32,
    first_total: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> ends: array<u32>;
@group(0) @binding(3) var<storage, read> corners: array<u32>;
@group(0) @binding(4) var<storage, read> pairs: array<Pair>;
@group(0) @binding(5) var<storage, read> presses: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> given: array<f32>;
@group(0) @binding(7) var<storage, read_write> parts: array<f32>;

override SETS: bool = true;

@compute @workgroup_size(64)
fn layer_force(
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
        var gradient = vec3f();
        let last = end_of(b, p, params.buckets, 4u * params.room);
        for (var k = begin_of(b, p, params.buckets); k < last; k++) {
            let corner = corners[b * 4u * params.room + k];
            let pair = b * params.room + min(corner / 4u, params.room - 1u);
            let press = presses[pair];
            gradient += pairs[pair].weights[corner % 4u] * press.xyz;
            energy += select(0.0, press.w, corner % 4u == 0u);
        }
        let added = accelerated(-gradient, marks[b * n + p], n);
        let at = b * 3u * n + p;
        for (var c = 0u; c < 3u; c++) {
            given[params.first_total + at + c * n] = given[params.first_source + at + c * n] + added[c];
        }
    }
    put_energy(b, part, lane, energy);
}
