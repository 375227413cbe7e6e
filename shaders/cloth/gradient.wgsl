// Gradient of the frame's energy with respect to the acceleration: grad = dL/da (`sim::EnergyTerms`).
//
// dx/da = 1 at a free particle and 0 at a handle, so there only inertia and the external term count.
// cloths: [B]; slots: [B, H, W]; external_acceleration, a, x, shift, grad: [B, 3, H, W].
// One invocation: one particle, which gathers from the edges, corner angles and bends it takes part in; nothing is
// scattered, so the order of every sum is fixed. Workgroups: (W / 8, H / 8, B).
// Adjoint: none, the gradient is an input of the training step and a constant there.

struct Params {
    rows: u32, // H
    columns: u32, // W
    zero: u32, // 0
    pad: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> external_acceleration: array<f32>;
@group(0) @binding(4) var<storage, read> a: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read> shift: array<f32>;
@group(0) @binding(7) var<storage, read_write> grad: array<f32>;

const RIGHT_ANGLE: f32 = 1.5707963267948966;

var<private> x0: vec3f;
var<private> shift0: vec3f;

// Where particle (i, j) is, seen from the particle of this invocation (x0, shift0).
fn position(b: u32, i: i32, j: i32) -> vec3f {
    let n = params.rows * params.columns;
    let at = b * 3u * n + u32(i) * params.columns + u32(j);
    let way = vec3f(shift[at], shift[at + n], shift[at + 2u * n]);
    return offset(vec3f(x[at], x[at + n], x[at + 2u * n]), x0, way, shift0, params.zero);
}

fn inside(i: i32, j: i32) -> bool {
    return i >= 0 && j >= 0 && i < i32(params.rows) && j < i32(params.columns);
}

// d(|q - p| - 1)^2 / dp; nothing where q is outside.
fn stretch(b: u32, p: vec3f, i: i32, j: i32) -> vec3f {
    if !inside(i, j) {
        return vec3f();
    }
    let edge = position(b, i, j) - p;
    let l = max(length(edge), 1e-30);
    return -2.0 * (l - 1.0) / l * edge;
}

// d/dp of the four squared corner angles of the cell whose corner opposite to p is (i, j); p = (i0, j0).
fn shear(b: u32, p: vec3f, i0: i32, j0: i32, i: i32, j: i32) -> vec3f {
    if !inside(i, j) {
        return vec3f();
    }
    // Edges through p along either axis, and those opposite to them; all point away from p's side, which leaves
    // (angle - pi / 2)^2 as it is.
    let down = position(b, i, j0);
    let across = position(b, i0, j);
    let corner = position(b, i, j);
    let near_v = down - p;
    let far_v = corner - across;
    let near_h = across - p;
    let far_h = corner - down;
    let at_p = angle_gradient(near_v, near_h, RIGHT_ANGLE);
    let at_down = angle_gradient(near_v, far_h, RIGHT_ANGLE);
    let at_across = angle_gradient(far_v, near_h, RIGHT_ANGLE);
    return -(at_p.u + at_p.w + at_down.u + at_across.w);
}

// d/dp of the squared bends along one axis that p takes part in; (di, dj) is the axis.
fn bend(b: u32, p: vec3f, i: i32, j: i32, di: i32, dj: i32) -> vec3f {
    let before = inside(i - di, j - dj);
    let after = inside(i + di, j + dj);
    var sum = vec3f();
    var back = vec3f();
    var ahead = vec3f();
    if before {
        back = p - position(b, i - di, j - dj);
        if inside(i - 2 * di, j - 2 * dj) {
            let previous = position(b, i - di, j - dj) - position(b, i - 2 * di, j - 2 * dj);
            sum += angle_gradient(previous, back, 0.0).w;
        }
    }
    if after {
        ahead = position(b, i + di, j + dj) - p;
        if inside(i + 2 * di, j + 2 * dj) {
            let next = position(b, i + 2 * di, j + 2 * dj) - position(b, i + di, j + dj);
            sum -= angle_gradient(ahead, next, 0.0).u;
        }
    }
    if before && after {
        let here = angle_gradient(back, ahead, 0.0);
        sum += here.u - here.w;
    }
    return sum;
}

@compute @workgroup_size(8, 8)
fn gradient(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.columns || id.y >= params.rows {
        return;
    }
    let b = id.z;
    let i = i32(id.y);
    let j = i32(id.x);
    let rows = f32(params.rows);
    let columns = f32(params.columns);
    let count = rows * columns;
    let n = params.rows * params.columns;
    let flat = id.y * params.columns + id.x;
    let at = b * 3u * n + flat;
    let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
    let f = vec3f(external_acceleration[at], external_acceleration[at + n], external_acceleration[at + 2u * n]);
    var sum = mass(id.y, id.x, params.rows, params.columns) / count * (acceleration - f);
    if slots[b * n + flat] == 0u {
        x0 = vec3f(x[at], x[at + n], x[at + 2u * n]);
        shift0 = vec3f(shift[at], shift[at + n], shift[at + 2u * n]);
        let p = vec3f();
        let material = cloths[b].material;
        let vertical = stretch(b, p, i - 1, j) + stretch(b, p, i + 1, j);
        let horizontal = stretch(b, p, i, j - 1) + stretch(b, p, i, j + 1);
        sum += material.x * (vertical / ((rows - 1.0) * columns) + horizontal / (rows * (columns - 1.0)));
        let corners = shear(b, p, i, j, i - 1, j - 1) + shear(b, p, i, j, i - 1, j + 1)
            + shear(b, p, i, j, i + 1, j - 1) + shear(b, p, i, j, i + 1, j + 1);
        let bends = bend(b, p, i, j, 1, 0) + bend(b, p, i, j, 0, 1);
        sum += (material.y * corners + material.z * bends) / count;
    }
    grad[at] = sum.x;
    grad[at + n] = sum.y;
    grad[at + 2u * n] = sum.z;
}
