
// What a particle is, in one word (`cloth::Mark`): four times its mass in the bits from MASS_BIT on, whether the cloth has
// the cell that begins there, and its slot: 0 if it is free, 1 + the index of its target if it is a handle, OUTSIDE if it is
// no part of the cloth.
const MASS_BIT: u32 = 29u;
const CELL: u32 = 0x10000000u;
const OUTSIDE: u32 = 0x0fffffffu;

fn slot_of(mark: u32) -> u32 {
    return mark & OUTSIDE;
}

fn is_free(mark: u32) -> bool {
    return slot_of(mark) == 0u;
}

fn is_outside(mark: u32) -> bool {
    return slot_of(mark) == OUTSIDE;
}

// Whether the cloth has the cell from this particle (i, j) to (i + 1, j + 1).
fn begins_cell(mark: u32) -> bool {
    return (mark & CELL) != 0u;
}

// Returns the mass: a quarter of each cell around the particle, 1 inside a sheet.
fn mass_of(mark: u32) -> f32 {
    return 0.25 * f32(mark >> MASS_BIT);
}
