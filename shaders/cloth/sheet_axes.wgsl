// Start of a frame of a subspace method: the sheet's own axes at each particle, its edges, and the
// accelerations of the last frame as a direction, with what extrapolates them (`extrapolate`).
//
// With the central differences of the predicted positions y = x + base (one-sided at the borders), of unit
// length, u along the first axis of the grid and v along the second, and
//   s = unit(u + v), normal = unit(u x v), d = +-unit(s x normal) with d . u >= 0,
// the axes are t1 = (s + d) / sqrt 2 and t2 = (s - d) / sqrt 2: orthogonal, and equally far from u and v. The
// third axis is t1 x t2. Where a difference has no direction they are the axes of the world. A particle stands for a
// neighbour that the cloth doesn't have.
//
// A force takes a particle less far next to a handle, and across a curved sheet. With the coefficients k_1 and k_2 of the stretch,
// the changes c_1 and c_2 from one edge to the next along u and v, and the distance d to the nearest handle,
//   |t1| = |t2| = near, |normal| = near / sqrt(1 + ARCHING (k_1 |c_1|^2 + k_2 |c_2|^2)),
//   near = 1 - HANDLE_SHARE / (1 + d), or 1 if no handle is within HANDLE_REACH rows and columns.
// The edges to (i+1, j) and to (i, j+1) have the root of their stiffness as length, and 0 if the cloth doesn't have them.
//
// cloths: [B]
// marks: [B, n]
// x, base: [B, 3, n]
// axes: [B, 16, n] = t1, t2, the normal, near, the edge down, the edge to the right
// directions: [K, slot], of which slot 2 [B, 3, n] becomes a, 0 where no free particle is and where a is not finite, and
//   slot 0 (2 - WARMEST) a - earlier, also 0 where no free particle is
// a: [B, 3, n], becomes 0
// earlier: [B, 3, n], becomes slot 2
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    slot: u32, // elements from a direction to the next, at least 3 B n
    zero: u32, // 0
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> x: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read_write> axes: array<f32>;
@group(0) @binding(6) var<storage, read_write> directions: array<f32>;
@group(0) @binding(7) var<storage, read_write> a: array<f32>;
@group(0) @binding(8) var<storage, read_write> earlier: array<f32>;

override HANDLE_SHARE: f32 = 0.5;
override HANDLE_REACH: u32 = 2;
override ARCHING: f32 = 0.03;
override WARMEST: f32 = 0.5;

// Shortest vector that has a direction.
const SHORTEST: f32 = 1e-12;

// Returns the vector from one particle to another, both by their first component, at the predicted positions.
fn difference(start: u32, end: u32, n: u32) -> vec3f {
    let x0 = vec3f(x[start], x[start + n], x[start + 2u * n]);
    let x1 = vec3f(x[end], x[end + n], x[end + 2u * n]);
    let shift0 = vec3f(base[start], base[start + n], base[start + 2u * n]);
    let shift1 = vec3f(base[end], base[end + n], base[end + 2u * n]);
    return offset(x1, x0, shift1, shift0, params.zero);
}

// Returns the unit vector, and in w whether there is one: 1, or 0 if the length is 0 or not finite.
fn unit(v: vec3f) -> vec4f {
    let l = length(v);
    if !is_finite(l) || l <= SHORTEST {
        return vec4f();
    }
    return vec4f(v / l, 1.0);
}

// Returns particle q, or p if the cloth doesn't have q.
fn neighbour(b: u32, p: u32, q: u32) -> u32 {
    return select(q, p, is_outside(marks[b * params.rows * params.columns + q]));
}

// Returns the square of the change from one edge to the next, 0 if one is missing (of length 0), or if it is not finite.
fn bend(one: vec3f, two: vec3f) -> f32 {
    let change = two - one;
    let square = dot(change, change);
    return select(0.0, square, length(one) > 0.0 && length(two) > 0.0 && is_finite(square));
}

// Returns an edge from particle p to q with the root of its stiffness as length, given that of the material's edges.
fn stiff(b: u32, p: u32, q: u32, edge: vec3f, stiffness: f32) -> vec3f {
    let first = b * params.rows * params.columns;
    let ends = stiffness_of(marks[first + p]) * stiffness_of(marks[first + q]);
    let factor = 0.5 * (stiffness_of(marks[first + p]) + stiffness_of(marks[first + q]));
    return select(vec3f(), sqrt(factor * stiffness) * unit(edge).xyz, ends > 0.0);
}

// Returns 1 / (1 + d) for the distance d of the nearest handle, 0 if there is none within HANDLE_REACH rows and columns.
fn nearness(b: u32, i: u32, j: u32) -> f32 {
    var nearest = 0xffffffffu;
    let first = vec2u(max(i, HANDLE_REACH), max(j, HANDLE_REACH)) - HANDLE_REACH;
    let last = min(vec2u(i, j) + HANDLE_REACH, vec2u(params.rows, params.columns) - 1u);
    for (var k = first.x; k <= last.x; k++) {
        for (var l = first.y; l <= last.y; l++) {
            let mark = marks[(b * params.rows + k) * params.columns + l];
            let away = vec2i(vec2u(i, j)) - vec2i(vec2u(k, l));
            let squared = u32(away.x * away.x + away.y * away.y);
            if !is_free(mark) && !is_outside(mark) {
                nearest = min(nearest, squared);
            }
        }
    }
    return select(1.0 / (1.0 + sqrt(f32(nearest))), 0.0, nearest == 0xffffffffu);
}

@compute @workgroup_size(64)
fn sheet_axes(
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
    let i = p / params.columns;
    let j = p % params.columns;
    let first = b * 3u * n;
    let above = neighbour(b, p, select(i - 1u, 0u, i == 0u) * params.columns + j);
    let below = neighbour(b, p, min(i + 1u, params.rows - 1u) * params.columns + j);
    let before = neighbour(b, p, i * params.columns + select(j - 1u, 0u, j == 0u));
    let behind = neighbour(b, p, i * params.columns + min(j + 1u, params.columns - 1u));
    let u1 = difference(first + above, first + p, n);
    let u2 = difference(first + p, first + below, n);
    let v1 = difference(first + before, first + p, n);
    let v2 = difference(first + p, first + behind, n);
    let u = unit(u1 + u2);
    let v = unit(v1 + v2);
    let s = unit(u.xyz + v.xyz);
    let normal = unit(cross(u.xyz, v.xyz));
    let d = unit(cross(s.xyz, normal.xyz));
    var t1 = vec3f(1.0, 0.0, 0.0);
    var t2 = vec3f(0.0, 1.0, 0.0);
    if u.w * v.w * s.w * normal.w * d.w > 0.0 {
        let towards_u = select(-d.xyz, d.xyz, dot(d.xyz, u.xyz) >= 0.0);
        t1 = 0.7071067811865476 * (s.xyz + towards_u);
        t2 = 0.7071067811865476 * (s.xyz - towards_u);
    }
    let cloth = cloths[b];
    let stretch = cloth.material.x * cloth.weave.xy;
    let near = 1.0 - HANDLE_SHARE * nearness(b, i, j);
    let arch = ARCHING * dot(stretch, vec2f(bend(u1, u2), bend(v1, v2)));
    let axis1 = near * t1;
    let axis2 = near * t2;
    let axis3 = near * inverseSqrt(1.0 + arch) * cross(t1, t2);
    let h = f32(params.rows);
    let w = f32(params.columns);
    let each = 2.0 * (1.0 + cloth.gravity.w) * stretch / vec2f((h - 1.0) * w, h * (w - 1.0));
    let down = stiff(b, p, below, u2, each.x);
    let right = stiff(b, p, behind, v2, each.y);
    let out = b * 16u * n + p;
    axes[out + 9u * n] = near;
    let free = is_free(marks[b * n + p]);
    for (var c = 0u; c < 3u; c++) {
        axes[out + c * n] = axis1[c];
        axes[out + (3u + c) * n] = axis2[c];
        axes[out + (6u + c) * n] = axis3[c];
        axes[out + (10u + c) * n] = down[c];
        axes[out + (13u + c) * n] = right[c];
        let at = first + c * n + p;
        let last = select(0.0, a[at], free && is_finite(a[at]));
        directions[2u * params.slot + at] = last;
        directions[at] = select(0.0, (2.0 - WARMEST) * last - earlier[at], free);
        a[at] = 0.0;
        earlier[at] = last;
    }
}
