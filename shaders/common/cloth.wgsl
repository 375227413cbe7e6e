
// Parameters of a cloth in grid units.
struct Cloth {
    material: vec4f, // stretch, shear, bend; curvature of contacts per mass, 0 without bodies
    gravity: vec4f, // acceleration, unused
    air: vec4f, // density and drag coefficients, unused
    repulsion: vec4f, // strength, distance (0 for no repulsion), search cells per edge length, unused
    layers: vec4f, // thickness of the contact with itself (0 for none), its friction, unused
}

// Returns the mass of particle (i, j): 1 inside, 1/2 on the border, 1/4 in the corners.
fn mass(i: u32, j: u32, rows: u32, columns: u32) -> f32 {
    let down = select(1.0, 0.5, i == 0u || i + 1u == rows);
    let across = select(1.0, 0.5, j == 0u || j + 1u == columns);
    return down * across;
}
