// Moves layers of a cloth away from each other that are too near, at the end of a frame: a particle moves by the mean of
// what its pairs ask for.
//
// marks: [B, n]
// ends: [B, buckets], where the list of each particle ends
// corners: [B, 4 room], see `layer_list`
// pairs: [B, room]
// presses: [B, room], what each pair asks for, see `layer_press`
// a: [B, 3, n]
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no self-contact.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    room: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> ends: array<u32>;
@group(0) @binding(3) var<storage, read> corners: array<u32>;
@group(0) @binding(4) var<storage, read> pairs: array<Pair>;
@group(0) @binding(5) var<storage, read> presses: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> a: array<f32>;

@compute @workgroup_size(64)
fn layer_part(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let b = group.z;
    if p >= n || !is_free(marks[b * n + p]) {
        return;
    }
    var asked = vec4f();
    let last = end_of(b, p, params.buckets, 4u * params.room);
    for (var k = begin_of(b, p, params.buckets); k < last; k++) {
        let corner = corners[b * 4u * params.room + k];
        let pair = b * params.room + min(corner / 4u, params.room - 1u);
        let press = presses[pair];
        let weight = pairs[pair].weights[corner % 4u];
        // The corner that is not part of the nearest point has nothing to do with it.
        asked += select(vec4f(), vec4f(weight * press.xyz, press.w), weight != 0.0);
    }
    if asked.w > 0.0 {
        let moved = asked.xyz / asked.w * (f32(n) / mass_of(marks[b * n + p]));
        for (var c = 0u; c < 3u; c++) {
            a[(b * 3u + c) * n + p] += moved[c];
        }
    }
}
