// Lists the pairs of each particle, in any order; `layer_order` gives them a fixed one.
//
// pair_ends: [B, buckets]
// pairs: [B, room]
// ends: [B, buckets], where the list of each particle ends
// counts: [B, buckets], 0 on entry; how many of them are listed
// corners: [B, 4 room] of 4 pair + corner
//
// One invocation per particle; they stride over the pairs. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no self-contact.

struct Params {
    buckets: u32,
    room: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pair_ends: array<u32>;
@group(0) @binding(2) var<storage, read> pairs: array<Pair>;
@group(0) @binding(3) var<storage, read> ends: array<u32>;
@group(0) @binding(4) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> corners: array<u32>;

@compute @workgroup_size(64)
fn layer_list(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let b = group.z;
    let count = pairs_of(b);
    for (var k = (group.y * groups.x + group.x) * 64u + lane; k < count; k += groups.x * groups.y * 64u) {
        let particles = pairs[b * params.room + k].particles & vec4u(~HELD);
        for (var corner = 0u; corner < 4u; corner++) {
            let p = min(particles[corner], params.buckets - 1u);
            let place = begin_of(b, p, params.buckets) + atomicAdd(&counts[b * params.buckets + p], 1u);
            corners[b * 4u * params.room + min(place, 4u * params.room - 1u)] = 4u * k + corner;
        }
    }
}
