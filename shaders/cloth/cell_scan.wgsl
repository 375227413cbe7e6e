// Where each bucket ends among the sorted particles: inclusive prefix sums of the counts of `cell_count`,
// which it resets to 0.
//
// counts, ends: [B, buckets]
//
// One workgroup per cloth. Each invocation takes an equal share of consecutive buckets. Workgroups: (B).
// Adjoint: none, training has no repulsion.

struct Params {
    buckets: u32, // a multiple of four times the invocations
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counts: array<vec4u>;
@group(0) @binding(2) var<storage, read_write> ends: array<vec4u>;

const LANES: u32 = 256u;

// Particles of each invocation, then inclusive prefix sums of them.
var<workgroup> sums: array<u32, LANES>;

@compute @workgroup_size(256)
fn cell_scan(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let share = params.buckets / (4u * LANES);
    let mine = (group.x * LANES + lane) * share;
    var sum = 0u;
    for (var k = 0u; k < share; k++) {
        let count = counts[mine + k];
        sum += count.x + count.y + count.z + count.w;
    }
    sums[lane] = sum;
    for (var step = 1u; step < LANES; step *= 2u) {
        workgroupBarrier();
        var before = 0u;
        if lane >= step {
            before = sums[lane - step];
        }
        workgroupBarrier();
        sums[lane] += before;
    }
    var end = sums[lane] - sum;
    for (var k = 0u; k < share; k++) {
        let count = counts[mine + k];
        let x = end + count.x;
        let y = x + count.y;
        let z = y + count.z;
        end = z + count.w;
        ends[mine + k] = vec4u(x, y, z, end);
        counts[mine + k] = vec4u();
    }
}
