// External acceleration: gravity, the control's accelerations, and pressure and friction of the air on each
// triangle.
//
// With v_rel = wind - mean velocity of the corners of a triangle and v_n = n . v_rel, the force on the
// triangle is density area |v_n| v_n n + drag area (v_rel - v_n n). Each corner gets one third of it, divided
// by the mass of the corner. Triangles are those of `Grid::faces`: each cell is cut along
// (i, j) - (i+1, j+1). Forces are evaluated at the start of the frame.
//
// cloths: [B]
// wind: [B, 3], velocity of the air
// x, v, control_accelerations, external_acceleration: [B, 3, H, W]
//
// One invocation per particle, which gathers from the up to six triangles around it.
// Workgroups: (W / 8, H / 8, B).
// Adjoint: none, external forces are constants of the training step.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> wind: array<f32>;
@group(0) @binding(3) var<storage, read> x: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> control_accelerations: array<f32>;
@group(0) @binding(6) var<storage, read_write> external_acceleration: array<f32>;

fn position(b: u32, i: i32, j: i32) -> vec3f {
    let n = params.rows * params.columns;
    let at = b * 3u * n + u32(i) * params.columns + u32(j);
    return vec3f(x[at], x[at + n], x[at + 2u * n]);
}

fn velocity(b: u32, i: i32, j: i32) -> vec3f {
    let n = params.rows * params.columns;
    let at = b * 3u * n + u32(i) * params.columns + u32(j);
    return vec3f(v[at], v[at + n], v[at + 2u * n]);
}

// Returns the force on the triangle with the given corners of cell (i, j), zero outside the grid.
fn triangle(b: u32, i: i32, j: i32, second: vec2i, third: vec2i) -> vec3f {
    if i < 0 || j < 0 || i + 1 >= i32(params.rows) || j + 1 >= i32(params.columns) {
        return vec3f();
    }
    let p = position(b, i, j);
    let across = cross(position(b, i + second.x, j + second.y) - p, position(b, i + third.x, j + third.y) - p);
    let twice = length(across);
    if twice < 1e-30 {
        return vec3f();
    }
    let normal = across / twice;
    let mean = (velocity(b, i, j) + velocity(b, i + second.x, j + second.y)
        + velocity(b, i + third.x, j + third.y)) / 3.0;
    let relative = vec3f(wind[3u * b], wind[3u * b + 1u], wind[3u * b + 2u]) - mean;
    let along = dot(normal, relative);
    let air = cloths[b].air;
    return 0.5 * twice * (air.x * abs(along) * along * normal + air.y * (relative - along * normal));
}

fn lower(b: u32, i: i32, j: i32) -> vec3f {
    return triangle(b, i, j, vec2i(1, 0), vec2i(1, 1));
}

fn upper(b: u32, i: i32, j: i32) -> vec3f {
    return triangle(b, i, j, vec2i(1, 1), vec2i(0, 1));
}

@compute @workgroup_size(8, 8)
fn external_force(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.columns || id.y >= params.rows {
        return;
    }
    let b = id.z;
    let i = i32(id.y);
    let j = i32(id.x);
    let n = params.rows * params.columns;
    let at = b * 3u * n + id.y * params.columns + id.x;
    var f = cloths[b].gravity.xyz
        + vec3f(control_accelerations[at], control_accelerations[at + n], control_accelerations[at + 2u * n]);
    if cloths[b].air.x != 0.0 || cloths[b].air.y != 0.0 {
        let air = lower(b, i, j) + upper(b, i, j)
            + lower(b, i - 1, j) + lower(b, i - 1, j - 1)
            + upper(b, i - 1, j - 1) + upper(b, i, j - 1);
        f += air / (3.0 * mass(id.y, id.x, params.rows, params.columns));
    }
    external_acceleration[at] = f.x;
    external_acceleration[at + n] = f.y;
    external_acceleration[at + 2u * n] = f.z;
}
