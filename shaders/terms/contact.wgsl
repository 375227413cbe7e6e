
// The contact of a particle with a body, as a function of its displacement y in the frame. Defined in plain words in
// `cloth::terms::contact`.
struct Contact {
    gradient: vec3f, // s n; 0 for no contact
    offset: f32, // s (h - g_0)
    drift: vec3f,
    friction: f32, // mu P
    thickness: f32, // h
    body: u32,
    padding: vec2u,
}

const STICKING: f32 = 1e-3;
const LEAST_GAP: f32 = 0.05;

fn contact_depth(contact: Contact, y: vec3f) -> f32 {
    return max(contact.offset - dot(contact.gradient, y), 0.0);
}

// Returns the displacement relative to the body along the plane.
fn contact_slip(contact: Contact, y: vec3f) -> vec3f {
    let u = y - contact.drift;
    let g = contact.gradient;
    return u - g * (dot(u, g) / max(dot(g, g), 1e-30));
}

// Returns the energy of barrier and friction.
fn contact_energy(contact: Contact, y: vec3f) -> f32 {
    let z = contact_depth(contact, y);
    let slip = length(contact_slip(contact, y));
    let slipping = select(slip - 0.5 * STICKING, 0.5 * slip * slip / STICKING, slip < STICKING);
    return z * z * z + contact.friction * slipping;
}

// Returns its derivative with respect to y.
fn contact_gradient(contact: Contact, y: vec3f) -> vec3f {
    let z = contact_depth(contact, y);
    let slip = contact_slip(contact, y);
    return -3.0 * z * z * contact.gradient + contact.friction / max(length(slip), STICKING) * slip;
}

// Returns how to leave what is nearer than LEAST_GAP of the thickness; 0 where nothing is.
fn contact_way_out(contact: Contact, y: vec3f) -> vec3f {
    let g = contact.gradient;
    let squared = dot(g, g);
    let deepest = sqrt(squared) * (1.0 - LEAST_GAP) * contact.thickness;
    let excess = contact.offset - dot(g, y) - deepest;
    return select(vec3f(), g * (excess / max(squared, 1e-30)), squared > 0.0 && excess > 0.0);
}
