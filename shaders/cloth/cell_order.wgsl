// Sorts the particles by bucket, and by number within a bucket: each particle counts those before it.
// Whatever is then summed over them has a fixed order, however they were counted.
//
// ends: [B, buckets]
// placed, in_bucket, numbers: [B, n]
// sorted: [B, n] of (bits of the position, particle number)
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
@group(0) @binding(4) var<storage, read> numbers: array<u32>;
@group(0) @binding(5) var<storage, read_write> sorted: array<vec4u>;

@compute @workgroup_size(64)
fn cell_order(
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
    let bucket = in_bucket[first + p];
    let begin = begin_of(b, bucket, params.buckets);
    let end = end_of(b, bucket, params.buckets, params.particles);
    var rank = begin;
    for (var k = begin; k < end; k++) {
        rank += select(0u, 1u, numbers[first + k] < p);
    }
    sorted[first + min(rank, params.particles - 1u)] = vec4u(placed[first + p].xyz, p);
}
