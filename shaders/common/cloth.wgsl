
// Parameters of a cloth in grid units.
struct Cloth {
    material: vec4f, // stretch, shear, bend; curvature of contacts per mass, 0 without bodies
    weave: vec4f, // factors of the stretch of edges down and across, of the bend down and across
    gravity: vec4f, // acceleration; damping of the stretch
    air: vec4f, // density and drag coefficients, unused
    repulsion: vec4f, // strength, distance (0 for no repulsion), search cells per edge length, unused
    layers: vec4f, // thickness of the contact with itself (0 for none), its friction, unused
}
