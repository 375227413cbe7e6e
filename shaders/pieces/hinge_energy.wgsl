
// Returns the energy of a couple.
fn hinge_energy(one: Hinge) -> f32 {
    if one.moment == 0.0 {
        return 0.0;
    }
    let sine = dot(one.axis, cross(one.before, one.after));
    let cosine = dot(one.before, one.after) - dot(one.axis, one.before) * dot(one.axis, one.after);
    let turn = angle(abs(sine), cosine);
    return one.moment * (0.5 * one.angle - select(turn, -turn, sine < 0.0));
}
