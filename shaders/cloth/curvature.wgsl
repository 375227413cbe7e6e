// Quadratic model of a cloth's energy in the span of K directions p_0 ... p_(K-1), and the energy itself, in
// partial sums over its particles.
//
// A_ij = p_i . d2L/da2 p_j (exact second derivatives of the terms in `shaders/terms`), b_i = p_i . g and |p_i|^2.
// With the change d_i of an edge e along direction i and its unit vector u, an edge of damping t adds
//   2 c (r (u . d_i)(u . d_j) / |e| + (1 + t - r / |e|) d_i . d_j),  r = 1 + t |e0|
// and an angle t between two edges what `add_angle` says. With K = 0 there is the energy alone.
//
// Each particle owns the edges, corner angles and bends that start at it, as in `energy`. `a` and the
// directions are 0 where no free particle is; `base` alone moves the others.
//
// cloths: [B]
// marks: [B, H, W]
// a, x, grad: [B, 3, H, W]
// base: [B, 3, H, W], and the external accelerations [B, 3, H, W] from element `first_external` on
// directions: [K, slot], [B, 3, H, W] each
// parts: [B, parts, 24] = A_00, A_01, A_02, A_03, A_11, A_12, A_13, A_22, A_23, A_33, b_0 ... b_3,
//   |p_0|^2 ... |p_3|^2 (0 for directions from K on), then stretch, shear, bend, inertia and external energy,
//   weighted as in the energy, and 0
//
// One invocation per particle. A workgroup strides over tiles of 8 x 8 particles, which are its part. Sums
// have a fixed order.
// Workgroups: (parts, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    parts: u32,
    slot: u32, // elements from a direction to the next, at least 3 B H W
    first_external: u32,
    zero: u32, // 0
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read> grad: array<f32>;
@group(0) @binding(7) var<storage, read> directions: array<f32>;
@group(0) @binding(8) var<storage, read_write> parts: array<vec4f>;

// Number of directions: 0, 3 or 4.
override K: u32 = 0;

const RIGHT_ANGLE: f32 = 1.5707963267948966;

// Starts and shifts of the particles of a tile, with a rim of two particles on the far sides, after the shift the factor of the
// stiffness there, 0 if the cloth has no such particle, and the components of all directions there: component c of direction i is element i.
const WITH_RIM: u32 = 10u;
var<workgroup> starts: array<vec3f, WITH_RIM * WITH_RIM>;
var<workgroup> shifts: array<vec4f, WITH_RIM * WITH_RIM>;
var<workgroup> along_x: array<vec4f, WITH_RIM * WITH_RIM>;
var<workgroup> along_y: array<vec4f, WITH_RIM * WITH_RIM>;
var<workgroup> along_z: array<vec4f, WITH_RIM * WITH_RIM>;

// Loads the tile that begins at particle (i, j).
fn load_tile(b: u32, i: u32, j: u32, lane: u32) {
    let n = params.rows * params.columns;
    for (var k = lane; k < WITH_RIM * WITH_RIM; k += 64u) {
        let row = i + k / WITH_RIM;
        let column = j + k % WITH_RIM;
        shifts[k] = vec4f();
        if row < params.rows && column < params.columns {
            let p = row * params.columns + column;
            let at = b * 3u * n + p;
            starts[k] = vec3f(x[at], x[at + n], x[at + 2u * n]);
            let shift = vec3f(base[at] + a[at], base[at + n] + a[at + n], base[at + 2u * n] + a[at + 2u * n]);
            shifts[k] = vec4f(shift, stiffness_of(marks[b * n + p]));
            if K > 0u {
                along_x[k] = of_directions(at);
                along_y[k] = of_directions(at + n);
                along_z[k] = of_directions(at + 2u * n);
            }
        }
    }
}

// An edge, and how each direction changes its components.
struct Edge {
    e: vec3f,
    x: vec4f,
    y: vec4f,
    z: vec4f,
    // 1 / |e|, or 0 if the edge has no length.
    inverse: f32,
    // The mean of the factors of the stiffness at its ends.
    stiffness: f32,
}

// Whether the cloth has a particle at this place of the tile.
fn has(place: u32) -> bool {
    return shifts[place].w > 0.0;
}

// Returns the edge from the particle at place `start` of the tile to that at place `end`.
fn edge(start: u32, end: u32) -> Edge {
    let e = offset(starts[end], starts[start], shifts[end].xyz, shifts[start].xyz, params.zero);
    let l = length(e);
    let inverse = select(0.0, 1.0 / max(l, SHORTEST), l > SHORTEST);
    let stiffness = 0.5 * (shifts[start].w + shifts[end].w);
    if K == 0u {
        return Edge(e, vec4f(), vec4f(), vec4f(), inverse, stiffness);
    }
    return Edge(
        e,
        along_x[end] - along_x[start],
        along_y[end] - along_y[start],
        along_z[end] - along_z[start],
        inverse,
        stiffness,
    );
}

// Returns the products of a vector with an edge's change in each direction.
fn change(v: vec3f, one: Edge) -> vec4f {
    return v.x * one.x + v.y * one.y + v.z * one.z;
}

// Returns the length at the start of the frame of the edge between two places, if there is damping.
fn before(start: u32, end: u32, damping: f32) -> f32 {
    if damping > 0.0 {
        return length(starts[end] - starts[start]);
    }
    return 1.0;
}

// Adds the second derivatives of the stretch of an edge with the coefficient c, and returns the energy.
fn add_stretch(one: Edge, each: f32, damping: f32, before: f32) -> f32 {
    let off = stretch_of(one.e);
    let c = each * one.stiffness;
    if K > 0u && one.inverse > 0.0 {
        let second = c * stretch_curvature(one.inverse, damping, before);
        let along = change(one.e, one) * one.inverse;
        add_products(second.y * along, along);
        add_products(second.x * one.x, one.x);
        add_products(second.x * one.y, one.y);
        add_products(second.x * one.z, one.z);
    }
    return c * (off * off + damping_of(off, damping, before));
}

// Adds the second derivatives of c (t - rest)^2, where t is the angle between two edges, and returns the energy.
//
// With the unit vectors u and w of the edges, the unit normal n of their plane, m_u across u towards w, m_w
// across w towards u, and the changes alpha_i and beta_i of the edges over their lengths, t changes by
// t_i = -(m_u . alpha_i + m_w . beta_i), and
//   A_ij += 2 c (t_i t_j + (t - rest) ((m_u . alpha_i)(u . alpha_j) + (u . alpha_i)(m_u . alpha_j)
//                                      + (m_w . beta_i)(w . beta_j) + (w . beta_i)(m_w . beta_j))
//                + s (cos t ((n . alpha_i)(n . alpha_j) + (n . beta_i)(n . beta_j))
//                     - (n . alpha_i)(n . beta_j) - (n . beta_i)(n . alpha_j)))
// with s = (t - rest) / sin t.
fn add_angle(first: Edge, second: Edge, rest: f32, c: f32) -> f32 {
    let shape = angle_shape(first.e, second.e, vec2f(first.inverse, second.inverse), rest);
    // An edge of no length forms no angle.
    if K > 0u && first.inverse > 0.0 && second.inverse > 0.0 {
        let along_u = change(shape.u, first) * first.inverse;
        let along_w = change(shape.w, second) * second.inverse;
        let across_u = change(cross(shape.n, shape.u), first) * first.inverse;
        let across_w = change(cross(shape.w, shape.n), second) * second.inverse;
        let normal_u = change(shape.n, first) * first.inverse;
        let normal_w = change(shape.n, second) * second.inverse;
        let twice = 2.0 * c;
        let turn = across_u + across_w;
        add_products(twice * turn, turn);
        let radial = twice * shape.off;
        add_products(radial * across_u, along_u);
        add_products(radial * along_u, across_u);
        add_products(radial * across_w, along_w);
        add_products(radial * along_w, across_w);
        let bent = twice * shape.s;
        add_products(bent * normal_u, shape.cosine * normal_u - normal_w);
        add_products(bent * normal_w, shape.cosine * normal_w - normal_u);
    }
    return c * (shape.off * shape.off);
}

// Six sums of each invocation, then of each group of eight invocations.
var<workgroup> sums: array<vec4f, 432>;

fn sum_of_eight(first: u32) -> vec4f {
    var sum = sums[first];
    for (var k = 1u; k < 8u; k++) {
        sum += sums[first + k];
    }
    return sum;
}

@compute @workgroup_size(64)
fn curvature(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.y;
    let n = params.rows * params.columns;
    let rows = f32(params.rows);
    let columns = f32(params.columns);
    let count = rows * columns;
    let material = cloths[b].material;
    let weave = cloths[b].weave;
    let vertical = material.x * weave.x / ((rows - 1.0) * columns);
    let horizontal = material.x * weave.y / (rows * (columns - 1.0));
    let shear = material.y / count;
    let bends = material.z * weave.zw / count;
    let damping = cloths[b].gravity.w;
    let tiles_across = (params.columns + 7u) / 8u;
    let tiles = tiles_across * ((params.rows + 7u) / 8u);
    curvature0 = vec4f();
    curvature1 = vec4f();
    curvature2 = vec2f();
    var slopes = vec4f();
    var squares = vec4f();
    var elastic = vec3f(); // stretch, shear, bend
    var driven = vec2f(); // inertia, external
    for (var tile = group.x; tile < tiles; tile += params.parts) {
        let first_row = tile / tiles_across * 8u;
        let first_column = tile % tiles_across * 8u;
        workgroupBarrier();
        load_tile(b, first_row, first_column, lane);
        workgroupBarrier();
        let i = first_row + lane / 8u;
        let j = first_column + lane % 8u;
        if i < params.rows && j < params.columns {
            let own = lane / 8u * WITH_RIM + lane % 8u;
            let below = own + WITH_RIM;
            let right = own + 1u;
            if has(own) && has(below) {
                let down = edge(own, below);
                elastic.x += add_stretch(down, vertical, damping, before(own, below, damping));
                if has(below + WITH_RIM) {
                    let bend = shifts[below].w * bends.x;
                    elastic.z += add_angle(down, edge(below, below + WITH_RIM), 0.0, bend);
                }
            }
            if has(own) && has(right) {
                let across = edge(own, right);
                elastic.x += add_stretch(across, horizontal, damping, before(own, right, damping));
                if has(right + 1u) {
                    let bend = shifts[right].w * bends.y;
                    elastic.z += add_angle(across, edge(right, right + 1u), 0.0, bend);
                }
            }
            // Edges need not point away from their corner: reversing one or both leaves the square of its angle
            // minus a right one unchanged.
            for (var corner = 0u; corner < 4u; corner++) {
                let v = own + corner % 2u;
                let h = own + corner / 2u * WITH_RIM;
                if has(v) && has(v + WITH_RIM) && has(h) && has(h + 1u) {
                    // Where both edges meet.
                    let c = shear * shifts[own + corner % 2u + corner / 2u * WITH_RIM].w;
                    elastic.y += add_angle(edge(v, v + WITH_RIM), edge(h, h + 1u), RIGHT_ANGLE, c);
                }
            }
            let p = i * params.columns + j;
            let at = b * 3u * n + p;
            let given = params.first_external + at;
            let f = vec3f(base[given], base[given + n], base[given + 2u * n]);
            let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
            let m = mass_of(marks[b * n + p]) / count;
            driven += particle_energies(acceleration, f, m);
            if K > 0u {
                let px = along_x[own];
                let py = along_y[own];
                let pz = along_z[own];
                let second = particle_curvature(m);
                add_products(second * px, px);
                add_products(second * py, py);
                add_products(second * pz, pz);
                slopes += px * grad[at] + py * grad[at + n] + pz * grad[at + 2u * n];
                squares += px * px + py * py + pz * pz;
            }
        }
    }
    sums[lane] = curvature0;
    sums[64u + lane] = curvature1;
    sums[128u + lane] = vec4f(curvature2, slopes.xy);
    sums[192u + lane] = vec4f(slopes.zw, squares.xy);
    sums[256u + lane] = vec4f(squares.zw, elastic.xy);
    sums[320u + lane] = vec4f(elastic.z, driven, 0.0);
    workgroupBarrier();
    if lane < 48u {
        sums[384u + lane] = sum_of_eight(lane * 8u);
    }
    workgroupBarrier();
    if lane < 6u {
        parts[(b * params.parts + group.x) * 6u + lane] = sum_of_eight(384u + lane * 8u);
    }
}
