// Start of a frame: the contacts that may arise for each particle, as planes until its end (`cpu::cloth::Contacts`).
//
// A particle's velocity takes it from x to x + base. Seen from the body it goes from one of the body's points to
// another; the plane is that of the body's surface where it meets the body on its way, else where it arrives. The way
// is searched in steps of the distance to the surface. The nearest of the bodies are kept if there are more than SLOTS.
//
// With h the thickness, m the mass over H W, g the gap before, and D the particle's block of the Hessian of the stretch,
// the stiffness is k = n . D n + m / min(g, gap predicted)^2 and the load for friction max(2 k / h (h - g)^2 with k at g,
// m (h - gap predicted)).
//
// cloths: [B]
// bodies: [B, count]
// fields: the distances of bodies that are meshes
// marks: [B, n]; only free particles have contacts
// x: [B, 3, n]
// base: [B, 3, n]
// contacts: [B, SLOTS, n]
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no bodies.

struct Params {
    rows: u32, // H
    columns: u32, // W
    bodies: u32, // most of a cloth
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> bodies: array<Body>;
@group(0) @binding(3) var<storage, read> marks: array<vec2u>;
@group(0) @binding(4) var<storage, read> x: array<f32>;
@group(0) @binding(5) var<storage, read> base: array<f32>;
@group(0) @binding(6) var<storage, read> fields: array<f32>;
@group(0) @binding(7) var<storage, read_write> contacts: array<Contact>;

override SLOTS: u32 = 1;

fn position(b: u32, p: u32) -> vec3f {
    let n = params.rows * params.columns;
    let at = b * 3u * n + p;
    return vec3f(x[at], x[at + n], x[at + 2u * n]);
}

// Whether the cloth has particle p of the grid.
fn has(b: u32, p: u32) -> bool {
    return !is_outside(marks[b * params.rows * params.columns + p]);
}

// A contact, and the gap that is predicted; a contact without gradient if the body is far away.
struct Found {
    contact: Contact,
    predicted: f32,
}

fn find(b: u32, p: u32, number: u32, own: vec3f, v: vec3f) -> Found {
    var found: Found;
    found.predicted = 1e30;
    let body = bodies[b * params.bodies + number];
    if body.kind == 0u {
        return found;
    }
    let start = inward(body.from_position, body.from_rotation, own);
    let end = inward(body.to_position, body.to_rotation, own + v);
    let way = end - start;
    let l = length(way);
    let h = body.thickness;
    let near = h + 2.0 * l + 1.0;
    if length(start) > reach_of(body) + near {
        return found;
    }
    let before = distance_to(body, start).w;
    if !(before <= near) {
        return found;
    }
    var place = end;
    if before > 0.0 && before <= l {
        var share = 0.0;
        for (var k = 0u; k < MOST_ADVANCES && share < 1.0; k++) {
            let here = start + share * way;
            let left = distance_to(body, here).w;
            if left <= 0.0 {
                place = here;
                break;
            }
            share += max(left / l, LEAST_ADVANCE);
        }
    }
    let surface = distance_to(body, place);
    let normal = rotated(body.to_rotation, surface.xyz);
    let at_place = outward(body.to_position, body.to_rotation, place);
    let at_start = dot(normal, own - at_place) + surface.w;
    let predicted = at_start + dot(normal, v);
    let count = f32(params.rows) * f32(params.columns);
    let m = mass_of(marks[b * params.rows * params.columns + p]) / count;
    let elastic = elastic_along(b, p, normal);
    let k = contact_stiffness(elastic, m, min(before, predicted), h);
    let pressed = contact_load(contact_stiffness(elastic, m, before, h), before, h);
    let stopped = m * max(h - predicted, 0.0);
    found.contact = contact_of(normal, at_start, k, h);
    found.contact.drift = at_place - outward(body.from_position, body.from_rotation, place);
    found.contact.friction = body.friction * max(pressed, stopped);
    found.contact.body = number;
    found.predicted = predicted;
    return found;
}

@compute @workgroup_size(64)
fn contact_find(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let b = group.z;
    if p >= n {
        return;
    }
    let first = b * SLOTS * n + p;
    var gaps = vec4f(-1e30);
    for (var k = 0u; k < SLOTS; k++) {
        contacts[first + k * n] = Contact();
    }
    if !is_free(marks[b * n + p]) {
        return;
    }
    let own = position(b, p);
    let at = b * 3u * n + p;
    let v = vec3f(base[at], base[at + n], base[at + 2u * n]);
    var used = 0u;
    for (var number = 0u; number < params.bodies; number++) {
        let found = find(b, p, number, own, v);
        if !(found.predicted < 1e30) {
            continue;
        }
        // The next free place, or that of the farthest.
        var place = used;
        if used == SLOTS {
            let farthest = max(max(gaps.x, gaps.y), max(gaps.z, gaps.w));
            if farthest <= found.predicted {
                continue;
            }
            let first_of = gaps == vec4f(farthest);
            place = select(select(select(3u, 2u, first_of.z), 1u, first_of.y), 0u, first_of.x);
        } else {
            used++;
        }
        // Not by an index, which would put them in memory.
        gaps = select(gaps, vec4f(found.predicted), vec4u(0u, 1u, 2u, 3u) == vec4u(place));
        contacts[first + place * n] = found.contact;
    }
}
