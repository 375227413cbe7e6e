// Sorts the list of pairs of each particle, so that whatever is summed over it has a fixed order, and resets the counts.
//
// ends: [B, buckets], where the list of each particle ends
// counts: [B, buckets]
// corners: [B, 4 room], see `layer_list`
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no self-contact.

struct Params {
    particles: u32, // n
    buckets: u32,
    room: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> ends: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;
@group(0) @binding(3) var<storage, read_write> corners: array<u32>;

@compute @workgroup_size(64)
fn layer_order(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.particles {
        return;
    }
    let b = group.z;
    counts[b * params.buckets + p] = 0u;
    let first = b * 4u * params.room;
    let begin = begin_of(b, p, params.buckets);
    let end = end_of(b, p, params.buckets, 4u * params.room);
    for (var k = begin + 1u; k < end; k++) {
        let own = corners[first + k];
        var to = k;
        for (; to > begin; to--) {
            let before = corners[first + to - 1u];
            if before <= own {
                break;
            }
            corners[first + to] = before;
        }
        corners[first + to] = own;
    }
}
