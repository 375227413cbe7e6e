// The cosine transform along the rows of fields of a sheet, to the kernel's binding z [B, 6, H, W]: z_f[i, l] = sum_j table[l, j] field_f[i, j]
// (`four_fields`).

// Returns column j of four rows of the table from row l on.
fn quad_of_cosines(l: u32, j: u32) -> vec4f {
    return vec4f(cosine(l, j), cosine(l + 1u, j), cosine(l + 2u, j), cosine(l + 3u, j));
}

// Stores the factors of the particles from column `first` on for the modes from `first_mode` on. Neighbouring invocations read neighbouring elements.
fn load_factors(lane: u32, first: u32, first_mode: u32) {
    for (var k = lane; k < 8u * TEAMS * DEPTH; k += LANES) {
        factors[place_of(k / DEPTH, k % DEPTH)] =
            quad_of_cosines(first_mode + 4u * (k / DEPTH), first + k % DEPTH);
    }
}

// Writes the columns of a quad that exist.
fn keep_modes(at: u32, v: vec4f, columns: u32) {
    if columns > 0u { z[at] = v.x; }
    if columns > 1u { z[at + 1u] = v.y; }
    if columns > 2u { z[at + 2u] = v.z; }
    if columns > 3u { z[at + 3u] = v.w; }
}
