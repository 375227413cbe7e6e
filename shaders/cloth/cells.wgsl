// The particles of a cloth sorted by the cells of a uniform grid in space, hashed into buckets: what `repulsion` looks through
// (paper section 3.4). The side of a cell is the distance of the repulsion, or 1 where there is none.
//
// cloths: [B]; slots: [B, n]; a, base, x: [B, 3, n]; ends: [B, buckets], where each bucket ends among the sorted particles (and
// the next one begins); bucketed, sorted: [B, n] of (position, particle number as bits), by buckets, in `sorted` also by number.
// One workgroup: one cloth, whose particles and buckets its invocations take in turn. Workgroups: (B).
// In a bucket particles arrive in any order; each then counts those before it, so that every sum over them has one order.
// Adjoint: none, training has no repulsion.

struct Params {
    particles: u32, // n
    buckets: u32, // a power of two, at least the workgroup's invocations
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> ends: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> bucketed: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> sorted: array<vec4f>;

const LANES: u32 = 256u;

// Particles in the buckets of each invocation, then in those up to and with them.
var<workgroup> counts: array<u32, LANES>;

@compute @workgroup_size(256)
fn cells(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.x;
    let n = params.particles;
    let first = b * n;
    let first_bucket = b * params.buckets;
    let mask = params.buckets - 1u;
    let distance = cloths[b].repulsion.y;
    let side = select(1.0, distance, distance > 0.0);
    for (var k = lane; k < params.buckets; k += LANES) {
        atomicStore(&ends[first_bucket + k], 0u);
    }
    storageBarrier();

    // Places are computed once: all that follows sees the same numbers.
    for (var p = lane; p < n; p += LANES) {
        let own = trial(b, p, n);
        let place = own.x + own.shift;
        sorted[first + p] = vec4f(place, 0.0);
        atomicAdd(&ends[first_bucket + bucket_of(cell_of(place, side), mask)], 1u);
    }
    storageBarrier();

    // From counts to beginnings: each invocation has as many buckets, one behind the other.
    let share = params.buckets / LANES;
    let mine = first_bucket + lane * share;
    var count = 0u;
    for (var k = 0u; k < share; k++) {
        count += atomicLoad(&ends[mine + k]);
    }
    counts[lane] = count;
    for (var step = 1u; step < LANES; step *= 2u) {
        workgroupBarrier();
        var before = 0u;
        if lane >= step {
            before = counts[lane - step];
        }
        workgroupBarrier();
        counts[lane] += before;
    }
    var begin = counts[lane] - count;
    for (var k = 0u; k < share; k++) {
        let here = atomicLoad(&ends[mine + k]);
        atomicStore(&ends[mine + k], begin);
        begin += here;
    }
    storageBarrier();

    // From beginnings to ends.
    for (var p = lane; p < n; p += LANES) {
        let place = sorted[first + p].xyz;
        let at = atomicAdd(&ends[first_bucket + bucket_of(cell_of(place, side), mask)], 1u);
        bucketed[first + at] = vec4f(place, bitcast<f32>(p));
    }
    storageBarrier();

    for (var k = lane; k < n; k += LANES) {
        let own = bucketed[first + k];
        let p = bitcast<u32>(own.w);
        let bucket = bucket_of(cell_of(own.xyz, side), mask);
        var start = 0u;
        if bucket > 0u {
            start = atomicLoad(&ends[first_bucket + bucket - 1u]);
        }
        let end = atomicLoad(&ends[first_bucket + bucket]);
        var rank = start;
        for (var other = start; other < end; other++) {
            rank += select(0u, 1u, bitcast<u32>(bucketed[first + other].w) < p);
        }
        sorted[first + rank] = own;
    }
}
