// What the layers of a cloth do to each other at the end of a frame (`cloth::LayerStats`).
//
// pair_ends: [B, buckets]
// missed_ends: [ROUNDS, stride], of which the first elements of a round are [B, buckets]: those of the searches at the
//   frame's end
// pairs: [B, room]
// a: [B, 3, n]
// given: base [B, 3, n], and more
// report: [B, 2] of (pairs, those that press, least gap, energy), (most pairs of a search at the frame's end, 0, 0, 0)
//
// One workgroup per cloth, whose invocations stride over the pairs. Workgroups: (B).
// Adjoint: none, training has no self-contact.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    room: u32,
    rounds: u32,
    stride: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pair_ends: array<u32>;
@group(0) @binding(2) var<storage, read> missed_ends: array<u32>;
@group(0) @binding(3) var<storage, read> pairs: array<Pair>;
@group(0) @binding(4) var<storage, read> a: array<f32>;
@group(0) @binding(5) var<storage, read> given: array<f32>;
@group(0) @binding(6) var<storage, read_write> report: array<vec4f>;

const LANES: u32 = 256u;

var<workgroup> sums: array<vec3f, LANES>; // those that press, least gap, energy

@compute @workgroup_size(256)
fn layer_report(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.x;
    let count = pairs_of(b);
    var touching = 0.0;
    var least = 1e30;
    var energy = 0.0;
    for (var k = lane; k < count; k += LANES) {
        let contact = pairs[b * params.room + k].contact;
        let y = across(b, pairs[b * params.room + k]);
        let gap = contact.thickness - (contact.offset - dot(contact.gradient, y)) / length(contact.gradient);
        touching += select(0.0, 1.0, gap < contact.thickness);
        least = min(least, gap);
        energy += contact_energy(contact, y);
    }
    sums[lane] = vec3f(touching, least, energy);
    for (var half = LANES / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            let one = sums[lane];
            let other = sums[lane + half];
            sums[lane] = vec3f(one.x + other.x, min(one.y, other.y), one.z + other.z);
        }
    }
    if lane == 0u {
        let last = b * params.buckets + params.buckets - 1u;
        var missed = 0u;
        for (var round = 0u; round < params.rounds; round++) {
            missed = max(missed, missed_ends[round * params.stride + last]);
        }
        report[2u * b] = vec4f(f32(pair_ends[last]), sums[0]);
        report[2u * b + 1u] = vec4f(f32(missed), 0.0, 0.0, 0.0);
    }
}
