// Gradient of the energy of a frame with respect to the acceleration, grad = dL/da (`cloth::EnergyTerms`, the terms
// in `shaders/terms`), and partial sums of squares, partial_sums[s, k] = (sum g^2, sum d^2) over part k of the particles of a sample,
// where d is the last step.
//
// dx/da is 1 at a free particle and 0 at a handle, where only inertia and the external term count.
//
// cloths: [B]
// slots: [B, H, W]
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
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read_write> fields: array<f32>;
@group(0) @binding(7) var<storage, read_write> partial_sums: array<f32>;

override LAST_STEP: bool = false;

const RIGHT_ANGLE: f32 = 1.5707963267948966;

// Starts and shifts of the particles of a tile, with a rim of two particles on every side where they exist.
const WITH_RIM: u32 = 12u;
var<workgroup> starts: array<vec3f, WITH_RIM * WITH_RIM>;
var<workgroup> shifts: array<vec3f, WITH_RIM * WITH_RIM>;

// Loads both for the tile that begins at particle (i, j).
fn load_tile(b: u32, i: u32, j: u32, lane: u32) {
    for (var k = lane; k < WITH_RIM * WITH_RIM; k += 64u) {
        let row = i + k / WITH_RIM;
        let column = j + k % WITH_RIM;
        // Row and column are counted from two before the first, so that neither is negative.
        if row >= 2u && column >= 2u && row < params.rows + 2u && column < params.columns + 2u {
            let one = trial(b, (row - 2u) * params.columns + column - 2u, params.rows * params.columns);
            starts[k] = one.x;
            shifts[k] = one.shift;
        }
    }
}

// Returns the position of the particle `rows` and `columns` away, relative to the particle of this lane;
// undefined if there is none.
fn position(lane: u32, rows: i32, columns: i32) -> vec3f {
    let own = (lane / 8u + 2u) * WITH_RIM + lane % 8u + 2u;
    let other = u32(i32(own) + rows * i32(WITH_RIM) + columns);
    return offset(starts[other], starts[own], shifts[other], shifts[own], params.zero);
}

// Returns d(|edge| - 1)^2 / dp for the edge that starts at p; zero if the edge does not exist.
fn stretch(edge: vec3f, exists: bool) -> vec3f {
    return select(vec3f(), -stretch_gradient(edge), exists);
}

// Returns d/dp of the four squared corner angles of a cell; zero if the cell does not exist. The other
// corners are relative to p, and `corner` is opposite to it.
fn shear(down: vec3f, across: vec3f, corner: vec3f, exists: bool) -> vec3f {
    if !exists {
        return vec3f();
    }
    // The edges along both axes, through p and opposite to it. All point away from p's side, which leaves
    // (angle - pi / 2)^2 unchanged.
    let far_v = corner - across;
    let far_h = corner - down;
    let at_p = angle_gradient(down, across, RIGHT_ANGLE);
    let at_down = angle_gradient(down, far_h, RIGHT_ANGLE);
    let at_across = angle_gradient(far_v, across, RIGHT_ANGLE);
    return -(at_p.u + at_p.w + at_down.u + at_across.w);
}

// Returns d/dp of the squared bends that involve p along one axis, where p is the k-th of `count` particles.
// The two particles before it and the two after it are relative to p.
fn bend(before: array<vec3f, 2>, after: array<vec3f, 2>, k: i32, count: i32) -> vec3f {
    var sum = vec3f();
    let back = -before[0];
    let ahead = after[0];
    if k >= 2 {
        sum += angle_gradient(before[0] - before[1], back, 0.0).w;
    }
    if k + 2 < count {
        sum -= angle_gradient(ahead, after[1] - after[0], 0.0).u;
    }
    if k >= 1 && k + 1 < count {
        let here = angle_gradient(back, ahead, 0.0);
        sum += here.u - here.w;
    }
    return sum;
}

// Returns the gradient at particle (i, j) of cloth b, the particle of this lane in the tile.
fn gradient_at(b: u32, i: i32, j: i32, lane: u32) -> vec3f {
    let last_row = i32(params.rows) - 1;
    let last_column = i32(params.columns) - 1;
    let rows = f32(params.rows);
    let columns = f32(params.columns);
    let count = rows * columns;
    let n = params.rows * params.columns;
    let p = u32(i) * params.columns + u32(j);
    let at = b * 3u * n + p;
    let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
    let given = params.first_external + at;
    let f = vec3f(base[given], base[given + n], base[given + 2u * n]);
    let m = mass(u32(i), u32(j), params.rows, params.columns) / count;
    var sum = particle_gradient(acceleration, f, m);
    if slots[b * n + p] == 0u {
        let material = cloths[b].material;
        let up = position(lane, -1, 0);
        let down = position(lane, 1, 0);
        let left = position(lane, 0, -1);
        let right = position(lane, 0, 1);
        let vertical = stretch(up, i > 0) + stretch(down, i < last_row);
        let horizontal = stretch(left, j > 0) + stretch(right, j < last_column);
        sum += material.x * (vertical / ((rows - 1.0) * columns) + horizontal / (rows * (columns - 1.0)));
        let corners = shear(up, left, position(lane, -1, -1), i > 0 && j > 0)
            + shear(up, right, position(lane, -1, 1), i > 0 && j < last_column)
            + shear(down, left, position(lane, 1, -1), i < last_row && j > 0)
            + shear(down, right, position(lane, 1, 1), i < last_row && j < last_column);
        let above = array(up, position(lane, -2, 0));
        let below = array(down, position(lane, 2, 0));
        let before = array(left, position(lane, 0, -2));
        let behind = array(right, position(lane, 0, 2));
        let bends = bend(above, below, i, i32(params.rows)) + bend(before, behind, j, i32(params.columns));
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
            let at = b * 3u * n + i * params.columns + j;
            let g = gradient_at(b, i32(i), i32(j), lane);
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
