// Gradient of the energy of a frame with respect to the acceleration, grad = dL/da (`cloth::EnergyTerms`, the terms
// in `shaders/terms`), and partial sums of squares, partial_sums[s, k] = (sum g^2, sum d^2) over part k of the particles of a sample,
// where d is the last step.
//
// dx/da is 1 at a free particle and 0 at a handle, where only inertia and the external term count. An edge exists if the
// cloth has both of its particles, an angle if both of its edges exist.
//
// cloths: [B]
// marks: [B, H, W]
// a, x: [B, 3, H, W]
// base: [B, 3, H, W], and the external accelerations [B, 3, H, W] from element `first_external` on
// fields: grad [B, 3, H, W] = [S, H, W]; with LAST_STEP also the last step [S, H, W] from element `last_step`
//   on, without it sum d^2 is 0
// partial_sums: [S, parts] pairs from sum `first_sum` on
//
// One invocation per particle, which gathers from the edges, corner angles and bends around it. Nothing is
// scattered, so that every sum has a fixed order. A workgroup strides over tiles of 8 x 8 particles, which
// are its part.
// Workgroups: (parts, B).
// Adjoint: none, the gradient and the norms are constants of the training step (paper section 3.3).

struct Params {
    rows: u32, // H
    columns: u32, // W
    parts: u32,
    first_sum: u32,
    last_step: u32,
    first_external: u32,
    zero: u32, // 0
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> fields: array<f32>;
@group(0) @binding(7) var<storage, read_write> partial_sums: array<f32>;

override LAST_STEP: bool = false;

const RIGHT_ANGLE: f32 = 1.5707963267948966;

// Starts and shifts of the particles of a tile, with a rim of two particles on every side, and in the last component the factor
// of the stiffness there, 0 if the cloth has no such particle.
const WITH_RIM: u32 = 12u;
var<workgroup> starts: array<vec3f, WITH_RIM * WITH_RIM>;
var<workgroup> shifts: array<vec4f, WITH_RIM * WITH_RIM>;

// Loads both for the tile that begins at particle (i, j).
fn load_tile(b: u32, i: u32, j: u32, lane: u32) {
    for (var k = lane; k < WITH_RIM * WITH_RIM; k += 64u) {
        let row = i + k / WITH_RIM;
        let column = j + k % WITH_RIM;
        // Row and column are counted from two before the first, so that neither is negative.
        shifts[k] = vec4f();
        if row >= 2u && column >= 2u && row < params.rows + 2u && column < params.columns + 2u {
            let n = params.rows * params.columns;
            let p = (row - 2u) * params.columns + column - 2u;
            let one = trial(b, p, n);
            starts[k] = one.x;
            shifts[k] = vec4f(one.shift, stiffness_of(marks[b * n + p]));
        }
    }
}

// Another particle relative to that of this lane, p; undefined unless the cloth has it.
struct Other {
    at: vec3f,
    stiffness: f32, // its factor
    exists: bool,
}

// Returns the place of the particle of this lane in the tile.
fn own_place(lane: u32) -> u32 {
    return (lane / 8u + 2u) * WITH_RIM + lane % 8u + 2u;
}

// Returns the particle `rows` and `columns` away.
fn other(lane: u32, rows: i32, columns: i32) -> Other {
    let own = own_place(lane);
    let place = u32(i32(own) + rows * i32(WITH_RIM) + columns);
    let shift = shifts[place];
    let at = offset(starts[place], starts[own], shift.xyz, shifts[own].xyz, params.zero);
    return Other(at, shift.w, shift.w > 0.0);
}

// Returns the derivative of the stretch of the edge from p to the particle `rows` and `columns` away with respect to p.
fn stretch(lane: u32, end: Other, rows: i32, columns: i32, damping: f32) -> vec3f {
    let own = own_place(lane);
    var before = 1.0;
    if damping > 0.0 {
        before = length(starts[u32(i32(own) + rows * i32(WITH_RIM) + columns)] - starts[own]);
    }
    let factor = 0.5 * (shifts[own].w + end.stiffness);
    return select(vec3f(), -factor * stretch_gradient(end.at, damping, before), end.exists);
}

// Returns d/dp of the squared corner angles of a cell around which p, whose stiffness is `own`, `down`, `across` and opposite to p
// `corner` lie.
fn shear(own: f32, down: Other, across: Other, corner: Other) -> vec3f {
    // The edges along both axes, through p and opposite to it. All point away from p's side, which leaves
    // (angle - pi / 2)^2 unchanged.
    let far_v = corner.at - across.at;
    let far_h = corner.at - down.at;
    var sum = vec3f();
    if down.exists && across.exists {
        let at_p = angle_gradient(down.at, across.at, RIGHT_ANGLE);
        sum = own * (at_p.u + at_p.w);
    }
    if down.exists && corner.exists {
        sum += down.stiffness * angle_gradient(down.at, far_h, RIGHT_ANGLE).u;
    }
    if across.exists && corner.exists {
        sum += across.stiffness * angle_gradient(far_v, across.at, RIGHT_ANGLE).w;
    }
    return -sum;
}

// Returns d/dp of the squared bends that involve p, whose stiffness is `own`, along one axis, given the two particles before it and
// the two after it.
fn bend(own: f32, before: array<Other, 2>, after: array<Other, 2>) -> vec3f {
    var sum = vec3f();
    let back = -before[0].at;
    let ahead = after[0].at;
    if before[0].exists && before[1].exists {
        sum += before[0].stiffness * angle_gradient(before[0].at - before[1].at, back, 0.0).w;
    }
    if after[0].exists && after[1].exists {
        sum -= after[0].stiffness * angle_gradient(ahead, after[1].at - ahead, 0.0).u;
    }
    if before[0].exists && after[0].exists {
        let here = angle_gradient(back, ahead, 0.0);
        sum += own * (here.u - here.w);
    }
    return sum;
}

// Returns the gradient at particle p of cloth b, the particle of this lane in the tile.
fn gradient_at(b: u32, p: u32, lane: u32) -> vec3f {
    let rows = f32(params.rows);
    let columns = f32(params.columns);
    let count = rows * columns;
    let n = params.rows * params.columns;
    let at = b * 3u * n + p;
    let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
    let given = params.first_external + at;
    let f = vec3f(base[given], base[given + n], base[given + 2u * n]);
    let mark = marks[b * n + p];
    let m = mass_of(mark) / count;
    var sum = particle_gradient(acceleration, f, m);
    if is_free(mark) {
        let material = cloths[b].material;
        let weave = cloths[b].weave;
        let own = stiffness_of(mark);
        let damping = cloths[b].gravity.w;
        let up = other(lane, -1, 0);
        let down = other(lane, 1, 0);
        let left = other(lane, 0, -1);
        let right = other(lane, 0, 1);
        let vertical = stretch(lane, up, -1, 0, damping) + stretch(lane, down, 1, 0, damping);
        let horizontal = stretch(lane, left, 0, -1, damping) + stretch(lane, right, 0, 1, damping);
        sum += material.x
            * (weave.x * vertical / ((rows - 1.0) * columns) + weave.y * horizontal / (rows * (columns - 1.0)));
        let corners = shear(own, up, left, other(lane, -1, -1)) + shear(own, up, right, other(lane, -1, 1))
            + shear(own, down, left, other(lane, 1, -1)) + shear(own, down, right, other(lane, 1, 1));
        let above = array(up, other(lane, -2, 0));
        let below = array(down, other(lane, 2, 0));
        let before = array(left, other(lane, 0, -2));
        let behind = array(right, other(lane, 0, 2));
        let bends = weave.z * bend(own, above, below) + weave.w * bend(own, before, behind);
        sum += (material.y * corners + material.z * bends) / count;
    }
    return sum;
}

// Six sums of each invocation, then of each group of eight invocations.
var<workgroup> sums: array<f32, 432>;

fn sum_of_eight(first: u32) -> f32 {
    var sum = sums[first];
    for (var k = 1u; k < 8u; k++) {
        sum += sums[first + k];
    }
    return sum;
}

@compute @workgroup_size(64)
fn gradient(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.y;
    let n = params.rows * params.columns;
    let across = (params.columns + 7u) / 8u;
    let tiles = across * ((params.rows + 7u) / 8u);
    var gradients = vec3f();
    var steps = vec3f();
    for (var tile = group.x; tile < tiles; tile += params.parts) {
        let first_row = tile / across * 8u;
        let first_column = tile % across * 8u;
        workgroupBarrier();
        load_tile(b, first_row, first_column, lane);
        workgroupBarrier();
        let i = first_row + lane / 8u;
        let j = first_column + lane % 8u;
        if i < params.rows && j < params.columns {
            let p = i * params.columns + j;
            let at = b * 3u * n + p;
            let g = gradient_at(b, p, lane);
            fields[at] = g.x;
            fields[at + n] = g.y;
            fields[at + 2u * n] = g.z;
            gradients += g * g;
            if LAST_STEP {
                let step = params.last_step + at;
                let d = vec3f(fields[step], fields[step + n], fields[step + 2u * n]);
                steps += d * d;
            }
        }
    }
    for (var c = 0u; c < 3u; c++) {
        sums[(2u * c) * 64u + lane] = gradients[c];
        sums[(2u * c + 1u) * 64u + lane] = steps[c];
    }
    workgroupBarrier();
    if lane < 48u {
        sums[384u + lane] = sum_of_eight(lane * 8u);
    }
    workgroupBarrier();
    if lane < 6u {
        let out = (params.first_sum + (3u * b + lane / 2u) * params.parts + group.x) * 2u + lane % 2u;
        partial_sums[out] = sum_of_eight(384u + lane * 8u);
    }
}
