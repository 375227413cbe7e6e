
// The contact of a particle with a body, or of two parts of a cloth, as a function of its displacement y in the frame, or of
// theirs relative to each other. Defined in plain words in
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
const STIFFEST: f32 = 0.1;
const MOST_ADVANCES: u32 = 64u;
const LEAST_ADVANCE: f32 = 0.0208333333;

// Returns the stiffness k, from the particle's own and its mass over the gap.
fn contact_stiffness(elastic: f32, m: f32, gap: f32, h: f32) -> f32 {
    let g = clamp(gap, STIFFEST * h, h);
    return elastic + m / (g * g);
}

// Returns the force of the barrier at a gap.
fn contact_load(stiffness: f32, gap: f32, h: f32) -> f32 {
    let depth = max(h - gap, 0.0);
    return 2.0 * stiffness / h * depth * depth;
}

// Returns the contact whose plane is `gap` away at y = 0.
fn contact_of(normal: vec3f, gap: f32, stiffness: f32, h: f32) -> Contact {
    let s = pow(2.0 * stiffness / (3.0 * h), 1.0 / 3.0);
    var contact: Contact;
    contact.gradient = s * normal;
    contact.offset = s * (h - gap);
    contact.thickness = h;
    return contact;
}

fn contact_depth(contact: Contact, y: vec3f) -> f32 {
    return max(contact.offset - dot(contact.gradient, y), 0.0);
}

// Returns the displacement relative to the body along the plane.
fn contact_slip(contact: Contact, y: vec3f) -> vec3f {
    let u = y - contact.drift;
    let g = contact.gradient;
    return u - g * (dot(u, g) / max(dot(g, g), 1e-30));
}

// Returns how to take back the slip of parts that press on each other and stick; 0 where they do not.
fn contact_slip_back(contact: Contact, y: vec3f) -> vec3f {
    let slip = contact_slip(contact, y);
    let sticks = contact.friction > 0.0 && contact_depth(contact, y) > 0.0 && length(slip) < STICKING;
    return select(vec3f(), -slip, sticks);
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

// Returns about how much it resists displacements: its second derivative across the plane and one of those along it.
fn contact_resistance(contact: Contact, y: vec3f) -> f32 {
    let barrier = 6.0 * contact_depth(contact, y) * dot(contact.gradient, contact.gradient);
    return barrier + contact.friction / max(length(contact_slip(contact, y)), STICKING);
}

// Returns how to leave what is nearer than LEAST_GAP of the thickness; 0 where nothing is.
fn contact_way_out(contact: Contact, y: vec3f) -> vec3f {
    let g = contact.gradient;
    let squared = dot(g, g);
    let deepest = sqrt(squared) * (1.0 - LEAST_GAP) * contact.thickness;
    let excess = contact.offset - dot(g, y) - deepest;
    return select(vec3f(), g * (excess / max(squared, 1e-30)), squared > 0.0 && excess > 0.0);
}
