
// Where a particle at x + shift is, seen from one at x0 + shift0. Differences of neighbouring coordinates are exact or nearly so;
// absolute positions would round the stiff edges by the size of the coordinates. Metal and DirectX may add up in another order,
// x + shift first, which is that rounding: a zero that only the host knows (`zero`) keeps the first difference apart.
fn offset(x: vec3f, x0: vec3f, shift: vec3f, shift0: vec3f, zero: u32) -> vec3f {
    let apart = bitcast<vec3f>(bitcast<vec3u>(x - x0) ^ vec3u(zero));
    return apart + (shift - shift0);
}
