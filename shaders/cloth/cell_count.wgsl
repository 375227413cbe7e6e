// Counts the particles in each bucket of cells, of a uniform grid in space whose cells are as wide as the repulsion reaches (paper
// section 3.4): the first of four kernels that sort them.
//
// cloths: [B]; slots: [B, n]; a, base, x: [B, 3, n]; counts: [B, buckets], 0 before; placed: [B, n] of (position, how many of the
// bucket came before, as bits). They come in any order; `cell_order` gives them one.
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
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> placed: array<vec4f>;

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
    let place = own.x + own.shift;
    let bucket = bucket_of(cell_of(place, cloths[b].repulsion.z), params.buckets - 1u);
    let before = atomicAdd(&counts[b * params.buckets + bucket], 1u);
    placed[b * params.particles + p] = vec4f(place, bitcast<f32>(before));
}
