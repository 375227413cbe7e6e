
// What a particle is, in two words (`cloth::Mark`). The first holds the number of cells around it in the bits from AREA_BIT
// on, whether the cloth has the cell that begins there, and its slot: 0 if it is free, 1 + the index of its target if it is a
// handle, OUTSIDE if it is no part of the cloth. The second holds the factors of its mass and of its stiffness.
const AREA_BIT: u32 = 29u;
const CELL: u32 = 0x10000000u;
const OUTSIDE: u32 = 0x0fffffffu;

fn slot_of(mark: vec2u) -> u32 {
    return mark.x & OUTSIDE;
}

fn is_free(mark: vec2u) -> bool {
    return slot_of(mark) == 0u;
}

fn is_outside(mark: vec2u) -> bool {
    return slot_of(mark) == OUTSIDE;
}

// Whether the cloth has the cell from this particle (i, j) to (i + 1, j + 1).
fn begins_cell(mark: vec2u) -> bool {
    return (mark.x & CELL) != 0u;
}

// Returns a positive, normal number from its half precision in the lower 16 bits: another bias, in front of more digits.
fn of_half(bits: u32) -> f32 {
    return bitcast<f32>((bits << 13u) + (112u << 23u));
}

// Returns the mass: a quarter of each cell around the particle, 1 inside a sheet, times its density.
fn mass_of(mark: vec2u) -> f32 {
    return 0.25 * f32(mark.x >> AREA_BIT) * of_half(mark.y & 0xffffu);
}

// Returns the factor of the stiffness at the particle, or 0 if it is no part of the cloth.
fn stiffness_of(mark: vec2u) -> f32 {
    return select(of_half(mark.y >> 16u), 0.0, is_outside(mark));
}
