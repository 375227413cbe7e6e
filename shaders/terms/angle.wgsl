
// The square of the angle between two edges minus its rest, without a coefficient: shear and bend. Defined in plain
// words in `cloth::terms::angle`.

// Returns atan2(sine, cosine) in [0, pi], for sine >= 0. WGSL allows atan2 an error of 4096 ulp, too much for
// small bends. Odd polynomial of degree 17 on [0, 1], with a maximum error of 6e-9 before rounding.
fn angle(sine: f32, cosine: f32) -> f32 {
    let c = abs(cosine);
    // The floor is a normal number: a device may flush subnormals to 0.
    let t = min(sine, c) / max(max(sine, c), 1e-37);
    let u = t * t;
    var p = 2.456718155e-3 * u - 1.440133176e-2;
    p = p * u + 3.978117984e-2;
    p = p * u - 7.234853497e-2;
    p = p * u + 1.049894413e-1;
    p = p * u - 1.416122864e-1;
    p = p * u + 1.998590668e-1;
    p = p * u - 3.333259702e-1;
    // The leading coefficient is 1 - 1.136e-7. The small part is added separately, or rounding would lose it.
    var theta = t + t * (p * u - 1.136e-7);
    if sine > c {
        theta = 1.5707963267948966 - theta;
    }
    if cosine < 0.0 {
        theta = 3.141592653589793 - theta;
    }
    return theta;
}

// Gradients of (angle(u, w) - rest)^2 with respect to u and w. At angles 0 and pi the direction of steepest
// ascent is undefined. There the factor is 0, except at angle = rest = 0, where it takes the limit angle /
// sine -> 1 / cosine.
struct AnglePair {
    u: vec3f,
    w: vec3f,
}

fn angle_gradient(u: vec3f, w: vec3f, rest: f32) -> AnglePair {
    let c = cross(u, w);
    let sine = length(c);
    let cosine = dot(u, w);
    var factor = 0.0; // 2 (angle - rest) / sine
    if sine > 1e-30 {
        factor = 2.0 * (angle(sine, cosine) - rest) / sine;
    } else if cosine > 1e-37 && rest == 0.0 {
        factor = 2.0 / cosine;
    }
    let uu = max(dot(u, u), 1e-30);
    let ww = max(dot(w, w), 1e-30);
    // With an edge of almost no length, a quotient may overflow, and infinity times a zero vector is NaN.
    let by_u = clamp(factor / uu, -3e38, 3e38);
    let by_w = clamp(factor / ww, -3e38, 3e38);
    return AnglePair(cross(u, c) * by_u, cross(c, w) * by_w);
}

// Returns (angle(u, w) - rest)^2.
fn squared_angle(u: vec3f, w: vec3f, rest: f32) -> f32 {
    let off = angle(length(cross(u, w)), dot(u, w)) - rest;
    return off * off;
}

// What the second derivatives of (t - rest)^2 are made of, where t is the angle between two edges: t - rest, the unit
// vectors of the edges and of their normal, cos t, and s = (t - rest) / sin t. For parallel edges s is its limit, 1,
// if rest = 0, and else 0.
struct AngleShape {
    off: f32,
    u: vec3f,
    w: vec3f,
    n: vec3f,
    cosine: f32,
    s: f32,
}

// Edges whose sine is below this count as parallel: rounding leaves their common normal undefined.
const PARALLEL: f32 = 1e-4;

// Returns the shape of the angle between two edges, given one over their lengths, which is 0 for an edge without a
// direction: then all but t - rest is meaningless.
fn angle_shape(first: vec3f, second: vec3f, inverses: vec2f, rest: f32) -> AngleShape {
    let normal = cross(first, second);
    let area = length(normal);
    let product = dot(first, second);
    let off = angle(area, product) - rest;
    let u = first * inverses.x;
    let w = second * inverses.y;
    let sine = area * inverses.x * inverses.y;
    let cosine = product * inverses.x * inverses.y;
    var n = normal / max(area, 1e-37);
    var s = off / max(sine, PARALLEL);
    if sine < PARALLEL {
        s = select(0.0, 1.0, rest == 0.0 && cosine > 0.0);
        // Any normal will do.
        n = normalize(select(vec3f(0.0, u.z, -u.y), vec3f(-u.z, 0.0, u.x), abs(u.x) > 0.7));
    }
    return AngleShape(off, u, w, n, cosine, s);
}
