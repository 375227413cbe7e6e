// External acceleration: gravity, the control's accelerations, and pressure and friction of the air on each cell.
//
// With the vector area of a cell (half the cross product of its diagonals), its size A and unit normal n, v_rel =
// wind - mean velocity of the corners, and v_n = n . v_rel, the force on the cell is
//   density A |v_n| / (1 + density A |v_n|) v_n n + drag A / (1 + drag A) (v_rel - v_n n),
// the drag after an implicit step of a free cell of mass 1. Each corner gets a quarter of it, divided by its mass.
//
// cloths: [B]
// marks: [B, H, W]
// wind: [B, 3], velocity of the air
// x, v, control_accelerations, external_acceleration: [B, 3, H, W]
//
// One invocation per particle, which gathers from the up to four cells around it.
// Workgroups: (W / 8, H / 8, B).
// Adjoint: none, external forces are constants of the training step.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> wind: array<f32>;
@group(0) @binding(4) var<storage, read> x: array<f32>;
@group(0) @binding(5) var<storage, read> v: array<f32>;
@group(0) @binding(6) var<storage, read> control_accelerations: array<f32>;
@group(0) @binding(7) var<storage, read_write> external_acceleration: array<f32>;

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

// Returns the force on cell (i, j), zero if the cloth doesn't have it.
fn cell(b: u32, i: i32, j: i32) -> vec3f {
    if i < 0 || j < 0 || !begins_cell(marks[b * params.rows * params.columns + u32(i) * params.columns + u32(j)]) {
        return vec3f();
    }
    let down_right = position(b, i + 1, j + 1) - position(b, i, j);
    let up_right = position(b, i, j + 1) - position(b, i + 1, j);
    let across = cross(down_right, up_right);
    let twice = length(across);
    if twice < 1e-30 {
        return vec3f();
    }
    let normal = across / twice;
    let mean = 0.25 * ((velocity(b, i, j) + velocity(b, i + 1, j + 1))
        + (velocity(b, i, j + 1) + velocity(b, i + 1, j)));
    let relative = vec3f(wind[3u * b], wind[3u * b + 1u], wind[3u * b + 2u]) - mean;
    let along = dot(normal, relative);
    let air = 0.5 * twice * cloths[b].air.xy;
    let pressure = air.x * abs(along);
    return pressure / (1.0 + pressure) * along * normal + air.y / (1.0 + air.y) * (relative - along * normal);
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
    let place = b * n + id.y * params.columns + id.x;
    if !is_outside(marks[place]) && (cloths[b].air.x != 0.0 || cloths[b].air.y != 0.0) {
        let air = (cell(b, i, j) + cell(b, i - 1, j - 1)) + (cell(b, i - 1, j) + cell(b, i, j - 1));
        f += air / (4.0 * mass_of(marks[place]));
    }
    external_acceleration[at] = f.x;
    external_acceleration[at + n] = f.y;
    external_acceleration[at + 2u * n] = f.z;
}
