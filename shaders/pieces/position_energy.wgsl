
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
