
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

// Whether the cloth has particle p of the grid.
fn has(b: u32, p: u32) -> bool {
    return motion[2u * (b * params.rows * params.columns + p)].w >= 0.0;
}

// Of a patch: whether the pairs of its first particle are wanted, and whether the cloth has its edges to the right and down,
// and its cell.
const WANTED: u32 = 1u;
const RIGHT: u32 = 2u;
const DOWN: u32 = 4u;
const WHOLE: u32 = 8u;

fn flags_of(b: u32, p: u32) -> u32 {
    return u32(motion[2u * (b * params.rows * params.columns + p) + 1u].w);
}

// Whether the cloth has all corners of the cell behind particle a.
fn is_whole(b: u32, a: u32) -> bool {
    return (flags_of(b, a) & WHOLE) != 0u;
}

// Returns the particles of the cell behind particle p, as far as the cloth has them; else others of them again.
fn patch_corners(b: u32, p: u32) -> vec4u {
    let flags = flags_of(b, p);
    let right = select(0u, 1u, (flags & RIGHT) != 0u);
    let down = select(0u, params.columns, (flags & DOWN) != 0u);
    // With both edges and no cell, the opposite corner is missing.
    let is_cut = (flags & (RIGHT | DOWN | WHOLE)) == (RIGHT | DOWN);
    return vec4u(p, p + right, p + down, select(p + right + down, p, is_cut));
}

// The centre of what the cloth doesn't have: out of reach.
const NOWHERE: f32 = 1e30;

// Returns a ball around the patch of particle p, its triangles and edges towards the larger numbers, from the kernel's
// binding motion [B, n, 2].
fn patch_ball(b: u32, p: u32) -> Ball {
    let corners = patch_corners(b, p);
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
    if !has(b, p) {
        ball.centre = vec3f(NOWHERE);
    }
    return ball;
}

// Whether the pairs of a particle of the patch are wanted.
fn is_wanted(b: u32, p: u32) -> bool {
    let corners = patch_corners(b, p);
    for (var k = 0u; k < 4u; k++) {
        if (flags_of(b, corners[k]) & WANTED) != 0u {
            return true;
        }
    }
    return false;
}
