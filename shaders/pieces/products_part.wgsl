
// Three sums of each invocation.
var<workgroup> sums: array<vec4f, 192>;

// Adds the sums of `products` over the 64 invocations of a workgroup, all of which call this, times a factor to the first
// ten numbers of its part, from the kernel's binding parts [B, parts, 24].
fn add_to_part(b: u32, part: u32, lane: u32, factor: f32) {
    sums[lane] = curvature0;
    sums[64u + lane] = curvature1;
    sums[128u + lane] = vec4f(curvature2, 0.0, 0.0);
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            for (var quad = 0u; quad < 192u; quad += 64u) {
                sums[quad + lane] += sums[quad + lane + half];
            }
        }
    }
    workgroupBarrier();
    if lane < 3u && part < params.parts {
        parts[(b * params.parts + part) * 6u + lane] += factor * sums[lane * 64u];
    }
}
