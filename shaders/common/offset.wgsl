
// Where a particle at x + shift is, seen from one at x0 + shift0. Differences of neighbouring coordinates are exact or nearly so;
// absolute positions would round the stiff edges by the size of the coordinates, and a cloth's common motion by the size of that.
// Metal and DirectX may add up in another order, which is that rounding: both differences are kept apart.
fn offset(x: vec3f, x0: vec3f, shift: vec3f, shift0: vec3f, zero: u32) -> vec3f {
    return kept_apart(x - x0, zero) + kept_apart(shift - shift0, zero);
}

// A number whose making no compiler joins with its use: it does not know that `zero`, which the host gives, is 0.
fn kept_apart(v: vec3f, zero: u32) -> vec3f {
    return bitcast<vec3f>(bitcast<vec3u>(v) ^ vec3u(zero));
}
