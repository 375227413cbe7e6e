
// Returns the exact GELU, x Phi(x).
fn gelu(x: vec4f) -> vec4f {
    return x * normal_cdf(x);
}

// Returns GELU'(x) = Phi(x) + x exp(-x^2 / 2) / sqrt(2 pi). The exponent is clamped: beyond the bound the
// product is negligible, and some drivers do not recover from infinity.
fn gelu_slope(x: vec4f) -> vec4f {
    return normal_cdf(x) + 0.3989422804014327 * x * exp(-min(0.5 * x * x, vec4f(80.0)));
}

// Returns Phi(x) = (1 + erf(x / sqrt 2)) / 2. WGSL has no erf: it is z P(z^2) / Q(z^2) here, with z clamped
// to |z| <= 3.95, where erf is within 3e-8 of 1. The coefficients come from a weighted least-squares fit
// iterated towards the minimax error (5e-8; 4e-7 when evaluated in single precision).
fn normal_cdf(x: vec4f) -> vec4f {
    let z = clamp(x * 0.7071067811865476, vec4f(-3.95), vec4f(3.95));
    let u = z * z;
    var p = 1.964157734e-8 * u - 1.991579359e-6;
    p = p * u + 1.513473039e-4;
    p = p * u + 4.090328685e-3;
    p = p * u + 5.177770134e-2;
    p = p * u + 2.089982875e-1;
    p = p * u + 1.128378742;
    var q = 1.051109399e-3 * u + 1.513226479e-2;
    q = q * u + 1.187549467e-1;
    q = q * u + 5.185482826e-1;
    q = q * u + 1.0;
    return 0.5 * (1.0 + z * p / q);
}
