// Counts the particles in each bucket of cells, the first of four kernels that sort the particles for the
// repulsion (paper section 3.4).
//
// The cells are those of a uniform grid in space, as wide as the repulsion reaches. Particles are counted in
// any order; `cell_order` gives them a fixed one. Particles out of reach are spread over the buckets by
// number: in a single bucket they would slow each other down.
//
// cloths: [B]
// marks: [B, n]
// a, base, x: [B, 3, n]
// counts: [B, buckets], 0 on entry
// placed: [B, n] of (bits of the position, how many particles of its bucket were counted before it)
// in_bucket: [B, n]
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no repulsion.

struct Params {
    particles: u32, // n
    buckets: u32, // a power of two
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> placed: array<vec4u>;
@group(0) @binding(8) var<storage, read_write> in_bucket: array<u32>;

// Out of reach.
const NOWHERE: f32 = 1e30;

@compute @workgroup_size(64)
fn cell_count(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.particles {
        return;
    }
    let b = group.z;
    let own = trial(b, p, params.particles);
    // What the cloth doesn't have repels nothing.
    let place = select(own.x + own.shift, vec3f(NOWHERE), is_outside(marks[b * params.particles + p]));
    let mask = params.buckets - 1u;
    var bucket = p & mask;
    if is_within_reach(place) {
        bucket = bucket_of(cell_of(place, cloths[b].repulsion.z), mask);
    }
    let before = atomicAdd(&counts[b * params.buckets + bucket], 1u);
    placed[b * params.particles + p] = vec4u(bitcast<vec3u>(place), before);
    in_bucket[b * params.particles + p] = bucket;
}
