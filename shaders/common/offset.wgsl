
// Returns the position of a particle at x + shift relative to one at x0 + shift0. Differences of neighbouring
// coordinates are exact or nearly so. Sums of absolute positions would be rounded to the magnitude of the
// coordinates, or of a cloth's common motion, which is too coarse for the stiff edges. Metal and DirectX may
// reassociate the sum and so bring that rounding back, which `opaque` prevents.
fn offset(x: vec3f, x0: vec3f, shift: vec3f, shift0: vec3f, zero: u32) -> vec3f {
    return opaque(x - x0, zero) + opaque(shift - shift0, zero);
}

// Returns v. No compiler merges the computation of v with its use, because none can know that `zero`, a
// parameter set by the host, is 0.
fn opaque(v: vec3f, zero: u32) -> vec3f {
    return bitcast<vec3f>(bitcast<vec3u>(v) ^ vec3u(zero));
}
