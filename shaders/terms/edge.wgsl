
// The stretch of an edge e with damping t, (|e| - 1)^2 + t (|e| - |e0|)^2, without its coefficient; r = 1 + t |e0|. Defined in plain
// words in `cloth::terms::edge`.

// Shortest edge that has a direction: the square of a shorter one is subnormal.
const SHORTEST: f32 = 1e-18;

// Returns |e| - 1.
fn stretch_of(e: vec3f) -> f32 {
    return length(e) - 1.0;
}

// Returns what the damping adds to the energy, given |e| - 1 and |e0|.
fn damping_of(off: f32, damping: f32, before: f32) -> f32 {
    let change = off - (before - 1.0);
    return damping * change * change;
}

// Returns the gradient with respect to e; zero for an edge without a direction.
fn stretch_gradient(e: vec3f, damping: f32, before: f32) -> vec3f {
    let l = length(e);
    let off = l - 1.0;
    let force = off + damping * (off - (before - 1.0));
    return select(vec3f(), 2.0 * force / max(l, SHORTEST) * e, l > SHORTEST);
}

// Returns the second derivatives, given 1 / |e|: that along every axis, and what is added to it along the edge.
fn stretch_curvature(inverse: f32, damping: f32, before: f32) -> vec2f {
    let tension = (1.0 + damping * before) * inverse;
    return 2.0 * vec2f(1.0 + damping - tension, tension);
}
