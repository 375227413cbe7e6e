
// The stretch of an edge e, (|e| - 1)^2, without its coefficient. Defined in plain words in `cloth::terms::edge`.

// Shortest edge that has a direction: the square of a shorter one is subnormal.
const SHORTEST: f32 = 1e-18;

// Returns |e| - 1.
fn stretch_of(e: vec3f) -> f32 {
    return length(e) - 1.0;
}

// Returns the gradient with respect to e; zero for an edge without a direction.
fn stretch_gradient(e: vec3f) -> vec3f {
    let l = length(e);
    return select(vec3f(), 2.0 * (l - 1.0) / max(l, SHORTEST) * e, l > SHORTEST);
}

// Returns the second derivatives, given 1 / |e|: that along every axis, and what is added to it along the edge.
fn stretch_curvature(inverse: f32) -> vec2f {
    return 2.0 * vec2f(1.0 - inverse, inverse);
}
