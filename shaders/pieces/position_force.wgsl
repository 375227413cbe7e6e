
// Of each invocation, then of the workgroup.
var<workgroup> energies: array<f32, 64>;

// Sums an energy over the 64 invocations of a workgroup, all of which call this, into the last number of its part, from the
// kernel's binding parts [B, groups, 8]: with SETS that is set, else increased.
fn put_energy(b: u32, part: u32, lane: u32, energy: f32) {
    energies[lane] = energy;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            energies[lane] += energies[lane + half];
        }
    }
    if lane == 0u && part < params.groups {
        let to = (b * params.groups + part) * 8u + 7u;
        if SETS {
            parts[to] = energies[0];
        } else {
            parts[to] += energies[0];
        }
    }
}

// Returns what a force adds to the acceleration of a particle of a cloth of n: nothing unless it is free.
fn accelerated(force: vec3f, mark: vec2u, n: u32) -> vec3f {
    return select(vec3f(), force * (f32(n) / mass_of(mark)), is_free(mark));
}
