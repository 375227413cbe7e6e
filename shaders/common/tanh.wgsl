
// Returns tanh, accurate to a few rounding errors. WGSL allows its own tanh an absolute error of 1e-5, and
// drivers that compute it from exponentials lose the digits of small arguments. Below 0.65, an odd polynomial
// of degree 11 with a maximum relative error of 7e-9 before rounding (weighted least squares iterated towards
// the minimax error); above, where nothing cancels, 1 - 2 / (exp(2 |x|) + 1).
fn tanh_exact(x: vec4f) -> vec4f {
    let u = x * x;
    var p = -5.515167180e-3 * u + 2.046942349e-2;
    p = p * u - 5.368802449e-2;
    p = p * u + 1.333083037e-1;
    p = p * u - 3.333325985e-1;
    let near = x + x * u * p;
    // The exponent is clamped: at 20 the result is already 1, and some drivers do not recover from infinity.
    let far = 1.0 - 2.0 / (exp(2.0 * min(abs(x), vec4f(20.0))) + 1.0);
    // NaN stays NaN: its comparison is false, which selects `near`.
    return select(near, sign(x) * far, abs(x) >= vec4f(0.65));
}
