
// Parameters of a cloth in grid units.
struct Cloth {
    material: vec4f, // stretch (of both axes together), shear, damping of the stretch; curvature of contacts per mass, 0 without bodies
    weave: vec4f, // stretch of edges down and across, bend down and across
    gravity: vec4f, // acceleration, unused
    air: vec4f, // density and drag coefficients, unused
    repulsion: vec4f, // strength, distance (0 for no repulsion), search cells per edge length, unused
    layers: vec4f, // thickness of the contact with itself (0 for none), its friction, unused
}
