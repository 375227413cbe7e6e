// Second derivatives of the repulsion (`repulsion`) along K directions p_0 ... p_(K-1), added to those of the other
// terms.
//
// With the difference r of two particles, s = r.r + e and the differences q_i of the directions there, an ordered
// pair adds to A_ij = p_i . d2L/da2 p_j
//   2 k / (H W) (2 (r.q_i) (r.q_j) / s^2 - q_i.q_j / s)
// The directions are 0 at handles.
//
// cloths: [B]
// ends: [B, buckets], see `cell_scan`
// sorted: [B, n], see `cell_order`
// directions: [K, slot], [B, 3, n] each
// parts: [B, parts, 24], see `curvature`; the first ten numbers of each part are increased
//
// One invocation per sorted particle, which searches the 27 cells around it for particles of a larger number. A
// workgroup takes every parts-th 64 of them, and adds to the part of its number. Sums have a fixed order.
// Workgroups: (parts, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    parts: u32,
    slot: u32, // elements from a direction to the next, at least 3 B n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> ends: array<u32>;
@group(0) @binding(3) var<storage, read> sorted: array<vec4u>;
@group(0) @binding(4) var<storage, read> directions: array<f32>;
@group(0) @binding(5) var<storage, read_write> parts: array<vec4f>;

// Number of directions: 3 or 4.
override K: u32 = 3;
override SOFTENING: f32;

// Adds what a particle adds with the particles of a cell that have a larger number, over 4 k / (H W).
fn add_cell(b: u32, cell: vec3i, own: vec3f, p: u32) {
    let n = params.rows * params.columns;
    let distance = cloths[b].repulsion.y;
    let per_edge = cloths[b].repulsion.z;
    let bucket = bucket_of(cell, params.buckets - 1u);
    let end = end_of(b, bucket, params.buckets, n);
    for (var k = begin_of(b, bucket, params.buckets); k < end; k++) {
        let other = sorted[b * n + k];
        let q = min(other.w, n - 1u);
        let place = bitcast<vec3f>(other.xyz);
        let r = own - place;
        let square = dot(r, r);
        // Other cells may share the bucket.
        let is_near = square < distance * distance && all(cell_of(place, per_edge) == cell);
        if is_near && q > p && !joined(p, q, params.columns) {
            let inverse = 1.0 / (square + SOFTENING);
            let first = b * 3u * n;
            let x = of_directions(first + p) - of_directions(first + q);
            let y = of_directions(first + n + p) - of_directions(first + n + q);
            let z = of_directions(first + 2u * n + p) - of_directions(first + 2u * n + q);
            let along = inverse * (r.x * x + r.y * y + r.z * z);
            add_products(2.0 * along, along);
            add_products(-inverse * x, x);
            add_products(-inverse * y, y);
            add_products(-inverse * z, z);
        }
    }
}

@compute @workgroup_size(64)
fn repulsion_curvature(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.y;
    let n = params.rows * params.columns;
    curvature0 = vec4f();
    curvature1 = vec4f();
    curvature2 = vec2f();
    if cloths[b].repulsion.y > 0.0 {
        for (var k = group.x * 64u + lane; k < n; k += params.parts * 64u) {
            let own = sorted[b * n + k];
            let place = bitcast<vec3f>(own.xyz);
            if is_within_reach(place) {
                let cell = cell_of(place, cloths[b].repulsion.z);
                for (var neighbour = 0; neighbour < 27; neighbour++) {
                    let direction = vec3i(neighbour / 9, neighbour / 3 % 3, neighbour % 3) - 1;
                    add_cell(b, cell + direction, place, min(own.w, n - 1u));
                }
            }
        }
    }
    add_to_part(b, group.x, lane, 4.0 * cloths[b].repulsion.x / f32(n));
}
