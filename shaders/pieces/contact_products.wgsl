
// Adds the second derivatives of a contact at the displacement y, along directions with these components, to the sums
// of `products`.
fn add_contact(one: Contact, y: vec3f, px: vec4f, py: vec4f, pz: vec4f) {
    let q = one.gradient;
    let z = contact_depth(one, y);
    let along = q.x * px + q.y * py + q.z * pz;
    add_products(6.0 * z * along, along);
    if one.friction > 0.0 {
        let slip = contact_slip(one, y);
        let l = length(slip);
        let f = one.friction / max(l, STICKING);
        let w = select(vec3f(), slip / max(l, STICKING), l >= STICKING);
        let of_slip = w.x * px + w.y * py + w.z * pz;
        add_products(f * px, px);
        add_products(f * py, py);
        add_products(f * pz, pz);
        add_products((-f / dot(q, q)) * along, along);
        add_products(-f * of_slip, of_slip);
    }
}
