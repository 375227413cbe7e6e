// Finds the pairs of parts of a cloth, a particle and a triangle or two edges, that come near each other on their ways
// (`cpu::cloth::Layers`): once to count those of each patch, and once to write them.
//
// A pair is looked at where it first comes nearer than half its thickness, else where the way ends, by steps of its
// distance over its speed: the plane between its nearest points there is its contact for the frame, unless the parts begin
// behind it: then they have come from the side, or out of layers that passed through each other. Of neighbouring triangles
// that are equally near one tells of the pair.
//
// With h the thickness, m = 1 / sum w^2 / m_k over the free particles, g the gap before, and D_k their blocks of the
// Hessian of the stretch, the stiffness is sum w^2 n . D_k n + m / min(g, gap predicted)^2; the load for friction as in
// `contact_find`.
//
// cloths: [B]
// motion: [B, n, 2], see `layer_motion`
// extents: [B]
// ends: [B, buckets], where each bucket of cells ends
// sorted: [B, n] of (bits of a patch's centre, number), by bucket
// pair_ends: [B, buckets], where the pairs of each patch end
// counts: [B, buckets]; set to the number of pairs of each patch, or increased by that of each particle
// pairs: [B, room]
//
// One invocation per patch, that of the particle at its start, which searches the 27 cells around it.
// Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no self-contact.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    room: u32,
    writes: u32, // 0 to count; the same code both times, so that it decides alike
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> motion: array<vec4f>;
@group(0) @binding(3) var<storage, read> extents: array<vec4f>;
@group(0) @binding(4) var<storage, read> ends: array<u32>;
@group(0) @binding(5) var<storage, read> sorted: array<vec4u>;
@group(0) @binding(6) var<storage, read> pair_ends: array<u32>;
@group(0) @binding(7) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> pairs: array<Pair>;

// Tolerance of the comparisons that decide which of two neighbouring triangles tells of a border [edges^2].
const LEVEL: f32 = 1e-6;

// Number of pairs that this patch has found, and where they are written.
var<private> found: u32;
var<private> first: u32;
var<private> end: u32;

fn position(b: u32, p: u32) -> vec3f {
    return place_of(b, p);
}

// Whether two balls come as near to each other as this.
fn meets(one: Ball, other: Ball, range: f32) -> bool {
    let to = other.centre - one.centre;
    let way = other.way - one.way;
    let share = share_of(-dot(to, way), dot(way, way));
    let nearest = to + share * way;
    let reach = one.size + other.size + range;
    return dot(nearest, nearest) < reach * reach;
}

// The four particles of a pair, seen from the first: the particle and the corners of the triangle, or the ends of one edge
// and those of the other.
struct Parts {
    particles: vec4u,
    is_edges: bool,
    places: array<vec3f, 4>,
    ways: array<vec3f, 4>,
}

fn parts_of(b: u32, particles: vec4u, is_edges: bool) -> Parts {
    var parts: Parts;
    parts.particles = particles;
    parts.is_edges = is_edges;
    let place = place_of(b, particles.x);
    let way = way_of(b, particles.x);
    for (var k = 1u; k < 4u; k++) {
        parts.places[k] = place_of(b, particles[k]) - place;
        parts.ways[k] = way_of(b, particles[k]) - way;
    }
    return parts;
}

// Returns particle k after this share of the way.
fn after(parts: ptr<function, Parts>, k: u32, share: f32) -> vec3f {
    return (*parts).places[k] + share * (*parts).ways[k];
}

fn distance_after(parts: ptr<function, Parts>, share: f32) -> f32 {
    let p1 = after(parts, 1u, share);
    let p2 = after(parts, 2u, share);
    let p3 = after(parts, 3u, share);
    if (*parts).is_edges {
        return distance_of_edges(p1, p3 - p2, -p2);
    }
    let weights = nearest_on_triangle(p1, p2, p3);
    return length(weights.x * p1 + weights.y * p2 + weights.z * p3);
}

// Whether balls around the two parts, and for edges their extents along the line between their middles, let them be as
// near as this.
fn may_meet(parts: ptr<function, Parts>, range: f32) -> bool {
    var one: Ball;
    var other: Ball;
    var radius = 0.0;
    var spread = 0.0;
    let first_of_other = select(1u, 2u, (*parts).is_edges);
    let count = f32(4u - first_of_other);
    for (var k = first_of_other; k < 4u; k++) {
        other.centre += (*parts).places[k] / count;
        other.way += (*parts).ways[k] / count;
    }
    for (var k = first_of_other; k < 4u; k++) {
        radius = max(radius, length((*parts).places[k] - other.centre));
        spread = max(spread, length((*parts).ways[k] - other.way));
    }
    other.size = radius + spread;
    if (*parts).is_edges {
        one.centre = 0.5 * (*parts).places[1];
        one.way = 0.5 * (*parts).ways[1];
        let own_spread = length(one.way);
        one.size = length(one.centre) + own_spread;
        let to = other.centre - one.centre;
        let half = 0.5 * ((*parts).places[3] - (*parts).places[2]);
        let extent = abs(dot(one.centre, to)) + abs(dot(half, to));
        let reach = range + length(other.way - one.way) + own_spread + spread;
        let square = dot(to, to);
        if square - extent > reach * sqrt(square) {
            return false;
        }
    }
    return meets(one, other, range);
}

// Returns the largest speed of a particle of one part relative to one of the other.
fn fastest(parts: ptr<function, Parts>) -> f32 {
    var most = max(length((*parts).ways[2]), length((*parts).ways[3]));
    if (*parts).is_edges {
        most = max(most, length((*parts).ways[2] - (*parts).ways[1]));
        return max(most, length((*parts).ways[3] - (*parts).ways[1]));
    }
    return max(most, length((*parts).ways[1]));
}

// Returns the place of a particle, seen from another, after this share of the way.
fn seen(b: u32, p: u32, origin: u32, share: f32) -> vec3f {
    return place_of(b, p) - place_of(b, origin) + share * (way_of(b, p) - way_of(b, origin));
}

// Whether the particle p is not nearer in the direction of the separation than the triangle that it borders on.
fn is_level(b: u32, p: u32, origin: u32, share: f32, separation: vec3f) -> bool {
    return dot(separation, seen(b, p, origin, share) + separation) <= LEVEL;
}

// Whether a triangle is the one that tells of a point on its side: if the triangle across is not nearer, the first of its
// cell.
fn tells_of_side(b: u32, face: u32, side: u32, origin: u32, share: f32, separation: vec3f) -> bool {
    let other = corner_across(face, side, params.rows, params.columns);
    if other == NO_CORNER || !is_whole(b, cell_across(face, side, params.columns)) {
        return true;
    }
    return face % 2u == 0u && is_level(b, other, origin, share, separation);
}

// Whether a triangle is the one that tells of its corner: if no edge from there leads nearer, one of those around it.
fn tells_of_corner(b: u32, face: u32, corner: u32, origin: u32, share: f32, separation: vec3f) -> bool {
    let w = params.columns;
    let p = corners_of(face, w)[corner];
    let up = p / w > 0u;
    let down = p / w + 1u < params.rows;
    let left = p % w > 0u;
    let right = p % w + 1u < w;
    let after = is_whole(b, p);
    let above = up && is_whole(b, p - w);
    let before = up && left && is_whole(b, p - w - 1u);
    // The first triangle of the cell that begins there, or else of the one above it, or before that; or the second of the one
    // to the left.
    var tells = false;
    if face % 2u == 0u {
        tells = corner == 0u || (corner == 1u && !after) || (corner == 2u && !after && !above);
    } else {
        tells = corner == 2u && !after && !above && !before;
    }
    tells = tells && (!up || !has(b, p - w) || is_level(b, p - w, origin, share, separation));
    tells = tells && (!down || !has(b, p + w) || is_level(b, p + w, origin, share, separation));
    tells = tells && (!left || !has(b, p - 1u) || is_level(b, p - 1u, origin, share, separation));
    tells = tells && (!right || !has(b, p + 1u) || is_level(b, p + 1u, origin, share, separation));
    tells = tells && (!before || is_level(b, p - w - 1u, origin, share, separation));
    return tells && (!after || is_level(b, p + w + 1u, origin, share, separation));
}

// The weights of the nearest points of two parts, which sum to 0, and the separation; zeros if others tell of it.
struct Nearest {
    weights: vec4f,
    separation: vec3f,
}

fn nearest_after(b: u32, parts: ptr<function, Parts>, face: u32, share: f32) -> Nearest {
    let p1 = after(parts, 1u, share);
    let p2 = after(parts, 2u, share);
    let p3 = after(parts, 3u, share);
    var nearest: Nearest;
    if (*parts).is_edges {
        let v = p3 - p2;
        let along = nearest_on_lines(p1, v, -p2);
        if along.z > 0.0 && all(along.xy > vec2f()) && all(along.xy < vec2f(1.0)) {
            nearest.weights = vec4f(1.0 - along.x, along.x, along.y - 1.0, -along.y);
            nearest.separation = along.x * p1 - p2 - along.y * v;
        }
        return nearest;
    }
    let weights = nearest_on_triangle(p1, p2, p3);
    let separation = -(weights.x * p1 + weights.y * p2 + weights.z * p3);
    let origin = (*parts).particles.x;
    let inside = weights > vec3f();
    var tells = true;
    if !all(inside) {
        // A corner has one weight, a side those of its first corner and the next.
        if u32(inside.x) + u32(inside.y) + u32(inside.z) == 1u {
            let corner = select(select(2u, 1u, inside.y), 0u, inside.x);
            tells = tells_of_corner(b, face, corner, origin, share, separation);
        } else {
            let side = select(select(2u, 1u, !inside.x), 0u, !inside.z);
            tells = tells_of_side(b, face, side, origin, share, separation);
        }
    }
    if tells {
        nearest.weights = vec4f(1.0, -weights);
        nearest.separation = separation;
    }
    return nearest;
}

// Returns the contact of two parts, `before` apart at the start; one without gradient between handles, or where the parts
// begin behind its plane.
fn pair_of(b: u32, parts: ptr<function, Parts>, nearest: Nearest, before: f32) -> Pair {
    let h = cloths[b].layers.x;
    let n = params.rows * params.columns;
    let l = length(nearest.separation);
    let normal = select(vec3f(0.0, 0.0, 1.0), nearest.separation / l, l > 0.0);
    var pair: Pair;
    pair.particles = (*parts).particles;
    pair.weights = nearest.weights;
    var at_start = 0.0;
    var predicted = 0.0;
    var per_mass = 0.0;
    var elastic = 0.0;
    for (var k = 0u; k < 4u; k++) {
        let p = pair.particles[k];
        let weight = pair.weights[k];
        at_start += weight * dot(normal, (*parts).places[k]);
        predicted += weight * dot(normal, after(parts, k, 1.0));
        let m = motion[2u * (b * n + p)].w;
        if !(m > 0.0) {
            pair.particles[k] |= HELD;
        } else {
            per_mass += weight * weight * f32(n) / m;
            elastic += weight * weight * elastic_along(b, p, normal);
        }
    }
    if per_mass > 0.0 && at_start >= -LEAST_GAP * h {
        let m = 1.0 / per_mass;
        let k = contact_stiffness(elastic, m, min(before, predicted), h);
        let pressed = contact_load(contact_stiffness(elastic, m, before, h), before, h);
        let stopped = m * max(h - predicted, 0.0);
        pair.contact = contact_of(normal, at_start, k, h);
        pair.contact.friction = cloths[b].layers.y * max(pressed, stopped);
    }
    return pair;
}

// Counts or writes the pair of these particles, if they come near each other.
fn look(b: u32, particles: vec4u, is_edges: bool, face: u32) {
    let range = extents[b].y;
    var parts = parts_of(b, particles, is_edges);
    if !may_meet(&parts, range) {
        return;
    }
    let before = distance_after(&parts, 0.0);
    let speed = fastest(&parts);
    // What is left at least.
    if !(before - speed < range) {
        return;
    }
    let near = extents[b].w;
    var share = 0.0;
    var left = before;
    if speed > 0.0 {
        for (var step = 0u; step < MOST_ADVANCES && left > near && share < 1.0; step++) {
            share = min(share + max((left - 0.5 * near) / speed, LEAST_ADVANCE), 1.0);
            left = distance_after(&parts, share);
        }
    }
    if !(left < range) {
        return;
    }
    let nearest = nearest_after(b, &parts, face, share);
    if all(nearest.weights == vec4f()) {
        return;
    }
    let pair = pair_of(b, &parts, nearest, before);
    if all(pair.contact.gradient == vec3f()) {
        return;
    }
    let to = first + found;
    found++;
    if params.writes != 0u && to < end {
        pairs[b * params.room + to] = pair;
        for (var k = 0u; k < 4u; k++) {
            atomicAdd(&counts[b * params.buckets + particles[k]], 1u);
        }
    }
}

// Looks at the pairs between two patches, p < q.
fn between(b: u32, p: u32, q: u32) {
    let w = params.columns;
    for (var k = 0u; k < 4u; k++) {
        let own = select(q, p, k < 2u);
        let other = select(p, q, k < 2u);
        if is_whole(b, other) {
            let face = first_face_of(other, w) + k % 2u;
            let corners = corners_of(face, w);
            if all(corners != vec3u(own)) {
                look(b, vec4u(own, corners), false, face);
            }
        }
    }
    for (var k = 0u; k < 3u; k++) {
        for (var l = 0u; l < 3u; l++) {
            let r = end_of_edge(b, p, k);
            let s = end_of_edge(b, q, l);
            if r != p && s != q && p != s && r != q && r != s {
                look(b, vec4u(p, r, q, s), true, 0u);
            }
        }
    }
}

// Returns where the edges of a patch end, to the right, down and along the diagonal; where they begin if there is none.
fn end_of_edge(b: u32, p: u32, k: u32) -> u32 {
    let corners = patch_corners(b, p);
    // Not by an index, which would put them in memory.
    let end_of_it = select(select(corners.w, corners.z, k == 1u), corners.y, k == 0u);
    return select(p, end_of_it, k < 2u || is_whole(b, p));
}

@compute @workgroup_size(64)
fn layer_find(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let index = (group.y * groups.x + group.x) * 64u + lane;
    let b = group.z;
    if index >= n {
        return;
    }
    let own = sorted[b * n + index];
    let centre = bitcast<vec3f>(own.xyz);
    let p = min(own.w, n - 1u);
    found = 0u;
    if params.writes != 0u {
        let last = b * params.buckets + params.buckets - 1u;
        first = select(pair_ends[b * params.buckets + max(p, 1u) - 1u], 0u, p == 0u);
        end = pair_ends[b * params.buckets + p];
        if first >= end || pair_ends[last] > params.room {
            return;
        }
    }
    if cloths[b].layers.x > 0.0 && is_wanted(b, p) && is_within_reach(centre) {
        let ball = patch_ball(b, p);
        let reach = extents[b].z + ball.size + length(ball.way);
        let per_edge = extents[b].x;
        let home = cell_of(centre, per_edge);
        for (var neighbour = 0; neighbour < 27; neighbour++) {
            let cell = home + vec3i(neighbour / 9, neighbour / 3 % 3, neighbour % 3) - 1;
            let bucket = bucket_of(cell, params.buckets - 1u);
            let last = end_of(b, bucket, params.buckets, n);
            for (var k = begin_of(b, bucket, params.buckets); k < last; k++) {
                let other = sorted[b * n + k];
                let place = bitcast<vec3f>(other.xyz);
                let q = min(other.w, n - 1u);
                let to = place - centre;
                // Other cells may share the bucket.
                if q == p || dot(to, to) > reach * reach || any(cell_of(place, per_edge) != cell) {
                    continue;
                }
                // Once for both.
                if (q > p || !is_wanted(b, q)) && meets(ball, patch_ball(b, q), extents[b].y) {
                    between(b, min(p, q), max(p, q));
                }
            }
        }
    }
    if params.writes == 0u {
        atomicStore(&counts[b * params.buckets + p], found);
    }
}
