// The particles of each bucket, in the order in which `cell_count` met them.
//
// cloths: [B]; ends: [B, buckets]; placed: [B, n]; numbers: [B, n], bucket by bucket.
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
    let own = placed[first + p];
    let bucket = bucket_of(cell_of(own.xyz, cloths[b].repulsion.z), params.buckets - 1u);
    numbers[first + begin_of(b, bucket, params.buckets) + bitcast<u32>(own.w)] = p;
}
