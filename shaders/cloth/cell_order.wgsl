// The particles sorted by buckets, and in a bucket by their numbers: each counts those before it, so that whatever is summed over
// them has one order, however they came.
//
// cloths: [B]; ends: [B, buckets]; placed: [B, n]; numbers: [B, n]; sorted: [B, n] of (position, particle number as bits).
// One invocation: one particle. Workgroups: (n / 64 along x, then y, and B).
// Adjoint: none, training has no repulsion.

struct Params {
    particles: u32, // n
    buckets: u32, // a power of two
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> ends: array<u32>;
@group(0) @binding(3) var<storage, read> placed: array<vec4f>;
@group(0) @binding(4) var<storage, read> numbers: array<u32>;
@group(0) @binding(5) var<storage, read_write> sorted: array<vec4f>;

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
    let place = placed[first + p].xyz;
    let bucket = bucket_of(cell_of(place, cloths[b].repulsion.z), params.buckets - 1u);
    let begin = begin_of(b, bucket, params.buckets);
    var rank = begin;
    for (var k = begin; k < ends[b * params.buckets + bucket]; k++) {
        rank += select(0u, 1u, numbers[first + k] < p);
    }
    sorted[first + rank] = vec4f(place, bitcast<f32>(p));
}
