
// What a particle adds to the energy by itself: inertia m |a|^2 / 2 and external energy -m a . f, with its mass m
// over the number of particles of the cloth. Defined in plain words in `cloth::terms::particle`.

// Returns inertia and external energy.
fn particle_energies(a: vec3f, f: vec3f, m: f32) -> vec2f {
    return m * vec2f(0.5 * dot(a, a), -dot(a, f));
}

// Returns their gradient with respect to a.
fn particle_gradient(a: vec3f, f: vec3f, m: f32) -> vec3f {
    return m * (a - f);
}

// Returns their second derivative, the same along every axis.
fn particle_curvature(m: f32) -> f32 {
    return m;
}
