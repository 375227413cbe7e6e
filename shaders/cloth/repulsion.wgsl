// Repulsion of particles close to each other (paper section 3.4): the acceleration it adds to the external
// one, and its energy in partial sums over the particles of a cloth.
//
// With strength k, distance delta and e = SOFTENING, the energy is -k / (H W) sum log((d^2 + e) / (delta^2 + e))
// over ordered pairs at a distance d < delta that no edge of the triangulated grid joins: 0 where a pair enters
// the range. A free particle of mass m gets the acceleration 4 k / m sum (x_p - x_q) / (d^2 + e).
//
// cloths: [B]
// marks: [B, n]
// given: the external accelerations [B, 3, n] from element `first_external` on; those with the repulsion from
//   `first_total` on
// ends: [B, buckets], see `cell_scan`
// sorted: [B, n], see `cell_order`
// parts: [B, groups, 8], of which the last number is set
//
// One invocation per sorted particle, which searches the 27 cells around it.
// Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no repulsion.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    groups: u32,
    first_external: u32,
    first_total: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> ends: array<u32>;
@group(0) @binding(4) var<storage, read> sorted: array<vec4u>;
@group(0) @binding(5) var<storage, read_write> given: array<f32>;
@group(0) @binding(6) var<storage, read_write> parts: array<f32>;

override SOFTENING: f32;

var<workgroup> energies: array<f32, 64>;

// Returns the sums of d / (d^2 + e) and -log((d^2 + e) / (delta^2 + e)) over the particles of a cell that repel
// the one at `own`.
fn from_cell(b: u32, cell: vec3i, own: vec3f, p: u32) -> vec4f {
    let n = params.rows * params.columns;
    let distance = cloths[b].repulsion.y;
    let per_edge = cloths[b].repulsion.z;
    let limit = distance * distance + SOFTENING;
    let bucket = bucket_of(cell, params.buckets - 1u);
    var sum = vec4f();
    let end = end_of(b, bucket, params.buckets, n);
    for (var k = begin_of(b, bucket, params.buckets); k < end; k++) {
        let other = sorted[b * n + k];
        let place = bitcast<vec3f>(other.xyz);
        let difference = own - place;
        let square = dot(difference, difference);
        // Other cells may share the bucket.
        let is_near = square < distance * distance && all(cell_of(place, per_edge) == cell);
        if is_near && !joined(p, other.w, params.columns) {
            sum += vec4f(difference / (square + SOFTENING), -log((square + SOFTENING) / limit));
        }
    }
    return sum;
}

@compute @workgroup_size(64)
fn repulsion(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let part = group.y * groups.x + group.x;
    let k = part * 64u + lane;
    let b = group.z;
    let strength = cloths[b].repulsion.x;
    var energy = 0.0;
    if k < n {
        let own = sorted[b * n + k];
        let place = bitcast<vec3f>(own.xyz);
        let p = min(own.w, n - 1u);
        var sum = vec4f();
        if cloths[b].repulsion.y > 0.0 && is_within_reach(place) {
            let cell = cell_of(place, cloths[b].repulsion.z);
            for (var neighbour = 0; neighbour < 27; neighbour++) {
                let direction = vec3i(neighbour / 9, neighbour / 3 % 3, neighbour % 3) - 1;
                sum += from_cell(b, cell + direction, place, p);
            }
        }
        energy = strength / f32(n) * sum.w;
        let mark = marks[b * n + p];
        let push = select(vec3f(), 4.0 * strength / mass_of(mark) * sum.xyz, is_free(mark));
        let at = b * 3u * n + p;
        for (var c = 0u; c < 3u; c++) {
            given[params.first_total + at + c * n] = given[params.first_external + at + c * n] + push[c];
        }
    }
    energies[lane] = energy;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            energies[lane] += energies[lane + half];
        }
    }
    if lane == 0u && part < params.groups {
        parts[(b * params.groups + part) * 8u + 7u] = energies[0];
    }
}
