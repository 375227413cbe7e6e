// Lists the particles of each bucket, in the order in which `cell_count` counted them.
//
// ends: [B, buckets]
// placed, in_bucket: [B, n]
// numbers: [B, n], bucket by bucket
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no repulsion.

struct Params {
    particles: u32, // n
    buckets: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> ends: array<u32>;
@group(0) @binding(2) var<storage, read> placed: array<vec4u>;
@group(0) @binding(3) var<storage, read> in_bucket: array<u32>;
@group(0) @binding(4) var<storage, read_write> numbers: array<u32>;

@compute @workgroup_size(64)
fn cell_fill(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.particles {
        return;
    }
    let b = group.z;
    let first = b * params.particles;
    let place = begin_of(b, in_bucket[first + p], params.buckets) + placed[first + p].w;
    // Stale counts would put it beyond the end.
    numbers[first + min(place, params.particles - 1u)] = p;
}
