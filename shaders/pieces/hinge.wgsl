
// A particle and the two edges along an axis of the grid that meet there, which a couple bends (`cpu::cloth::Couples`).
struct Hinge {
    axis: vec3f, // about which they turn, of length 1
    before: vec3f,
    after: vec3f,
    angle: f32, // at rest
    moment: f32, // 0 where there is no couple
}

// Least squared lever arm of a couple: on an edge that comes nearer to the axis, its force stays finite.
const NEAREST: f32 = 1e-2;

// Whether cloth b has the particle (i, j).
fn exists(b: u32, at: vec2i) -> bool {
    if any(at < vec2i(0)) || at.x >= i32(params.rows) || at.y >= i32(params.columns) {
        return false;
    }
    return !is_outside(marks[(b * params.rows + u32(at.x)) * params.columns + u32(at.y)]);
}

fn trial_of(b: u32, at: vec2i) -> Trial {
    return trial(b, u32(at.x) * params.columns + u32(at.y), params.rows * params.columns);
}

// Returns where velocities and targets take particle (i, j) `at`.
fn predicted(b: u32, at: vec2i) -> vec3f {
    let n = params.rows * params.columns;
    let k = b * 3u * n + u32(at.x) * params.columns + u32(at.y);
    return vec3f(x[k], x[k + n], x[k + 2u * n]) + vec3f(base[k], base[k + n], base[k + 2u * n]);
}

// Returns the edge between two particles of the trial. The stiff terms need it without rounding (`offset`), the
// couples do not.
fn edge_between(p: Trial, q: Trial) -> vec3f {
    return (q.x - p.x) + (q.shift - p.shift);
}

// Returns the particles of the grid's next row, along axis 0, the height, or of its next column.
fn step_along(axis: u32) -> vec2i {
    return select(vec2i(0, 1), vec2i(1, 0), axis == 0u);
}

// Returns the hinge at particle (i, j) `at` along an axis, from the kernel's bindings cloths, marks, rest_angles, x,
// base and a.
fn hinge(b: u32, at: vec2i, axis: u32) -> Hinge {
    let along = step_along(axis);
    if !exists(b, at) || !exists(b, at - along) || !exists(b, at + along) {
        return Hinge();
    }
    let place = (b * params.rows + u32(at.x)) * params.columns + u32(at.y);
    let angle = rest_angles[place][axis];
    if angle == 0.0 {
        return Hinge();
    }
    let first = select(at, at - along.yx, exists(b, at - along.yx));
    let last = select(at, at + along.yx, exists(b, at + along.yx));
    // Along the height, the front is where the sheet turns the other way.
    let difference = select(1.0, -1.0, axis == 0u) * (predicted(b, last) - predicted(b, first));
    let reach = length(difference);
    if !(reach > 1e-12) {
        return Hinge();
    }
    let own = trial_of(b, at);
    let bend = cloths[b].material.z * cloths[b].weave[2u + axis] / (f32(params.rows) * f32(params.columns));
    let moment = 2.0 * bend * stiffness_of(marks[place]) * angle;
    let before = edge_between(trial_of(b, at - along), own);
    let after = edge_between(own, trial_of(b, at + along));
    return Hinge(difference / reach, before, after, angle, moment);
}
