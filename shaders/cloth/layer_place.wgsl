// Counts the patches of a cloth in each bucket of cells, as `cell_count` does with particles: patches whose centres are not
// in neighbouring cells have no parts that touch.
//
// motion: [B, n, 2], see `layer_motion`
// extents: [B]
// counts: [B, buckets], 0 on entry
// placed: [B, n] of (bits of the centre, how many patches of its bucket were counted before it)
// in_bucket: [B, n]
//
// One invocation per patch, which is that of the particle at its start. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no self-contact.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32, // a power of two
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> motion: array<vec4f>;
@group(0) @binding(2) var<storage, read> extents: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> placed: array<vec4u>;
@group(0) @binding(5) var<storage, read_write> in_bucket: array<u32>;

@compute @workgroup_size(64)
fn layer_place(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= n {
        return;
    }
    let b = group.z;
    let centre = patch_ball(b, p).centre;
    let mask = params.buckets - 1u;
    var bucket = p & mask;
    if is_within_reach(centre) {
        bucket = bucket_of(cell_of(centre, extents[b].x), mask);
    }
    let before = atomicAdd(&counts[b * params.buckets + bucket], 1u);
    placed[b * n + p] = vec4u(bitcast<vec3u>(centre), before);
    in_bucket[b * n + p] = bucket;
}
