
// A ball that moves evenly in the frame.
struct Ball {
    centre: vec3f,
    size: f32, // radius, and how much of their way the points inside may go off that of the ball
    way: vec3f,
}

fn place_of(b: u32, p: u32) -> vec3f {
    return motion[2u * (b * params.rows * params.columns + p)].xyz;
}

fn way_of(b: u32, p: u32) -> vec3f {
    return motion[2u * (b * params.rows * params.columns + p) + 1u].xyz;
}

// Returns the particles of the cell behind particle p; where there are none, others of them again.
fn patch_corners(p: u32) -> vec4u {
    let down = select(0u, params.columns, p / params.columns + 1u < params.rows);
    let right = select(0u, 1u, p % params.columns + 1u < params.columns);
    return vec4u(p, p + right, p + down, p + right + down);
}

// Returns a ball around the patch of particle p, its triangles and edges towards the larger numbers, from the kernel's
// binding motion [B, n, 2].
fn patch_ball(b: u32, p: u32) -> Ball {
    let corners = patch_corners(p);
    var ball: Ball;
    for (var k = 0u; k < 4u; k++) {
        ball.centre += 0.25 * place_of(b, corners[k]);
        ball.way += 0.25 * way_of(b, corners[k]);
    }
    var radius = 0.0;
    var spread = 0.0;
    for (var k = 0u; k < 4u; k++) {
        radius = max(radius, length(place_of(b, corners[k]) - ball.centre));
        spread = max(spread, length(way_of(b, corners[k]) - ball.way));
    }
    ball.size = radius + spread;
    return ball;
}

// Whether the pairs of a particle of the patch are wanted.
fn is_wanted(b: u32, p: u32) -> bool {
    let corners = patch_corners(p);
    for (var k = 0u; k < 4u; k++) {
        if motion[2u * (b * params.rows * params.columns + corners[k]) + 1u].w > 0.0 {
            return true;
        }
    }
    return false;
}
