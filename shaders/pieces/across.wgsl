
// Returns the displacement of a particle of a pair, from the kernel's bindings a [B, 3, n] and given, which begins with
// base [B, 3, n].
fn displacement_of(b: u32, particle: u32) -> vec3f {
    let n = params.rows * params.columns;
    let at = b * 3u * n + (particle & ~HELD);
    let by_velocity = vec3f(given[at], given[at + n], given[at + 2u * n]);
    let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
    return by_velocity + select(acceleration, vec3f(), (particle & HELD) != 0u);
}

// Returns how far the parts of a pair move relative to each other.
fn across(b: u32, pair: Pair) -> vec3f {
    var y = vec3f();
    for (var k = 0u; k < 4u; k++) {
        y += pair.weights[k] * displacement_of(b, pair.particles[k]);
    }
    return y;
}
