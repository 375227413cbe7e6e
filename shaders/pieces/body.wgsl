
// A body and how it moves in a frame (`cloth::Body`, `cloth::Sweep`), in grid units. The sizes of a mesh are its unit,
// the inset, and the radius of a ball around the origin that holds it.
struct Body {
    sizes: vec3f,
    kind: u32, // 0 none, 1 plane, 2 sphere, 3 capsule, 4 box, 5 mesh
    thickness: f32,
    friction: f32,
    field: u32, // where a mesh's distances begin in `fields`, which a kernel that uses this file binds
    padding: u32,
    from_position: vec4f,
    from_rotation: vec4f, // quaternion (x, y, z, w)
    to_position: vec4f,
    to_rotation: vec4f,
}

// Returns a vector rotated by a quaternion.
fn rotated(q: vec4f, v: vec3f) -> vec3f {
    let t = 2.0 * cross(q.xyz, v);
    return v + q.w * t + cross(q.xyz, t);
}

// Returns the body's own point at a place, given its position and rotation.
fn inward(position: vec4f, rotation: vec4f, place: vec3f) -> vec3f {
    return rotated(vec4f(-rotation.xyz, rotation.w), place - position.xyz);
}

// Returns the place of a body's own point.
fn outward(position: vec4f, rotation: vec4f, own: vec3f) -> vec3f {
    return rotated(rotation, own) + position.xyz;
}

// Returns the normal and the distance of a point from a ball around the origin.
fn around(p: vec3f, radius: f32) -> vec4f {
    let l = length(p);
    return vec4f(select(vec3f(0.0, 0.0, 1.0), p / l, l > 0.0), l - radius);
}

// Returns the gradient of the trilinear interpolant of a mesh's distances, and its value (`cloth::DistanceField`). `place`
// is in cells from the first node, whose distance is at `first`; `nodes` are those along each axis.
fn interpolated(first: u32, nodes: vec3u, place: vec3f) -> vec4f {
    // The last node of an axis belongs to the cell before it.
    let node = min(vec3u(place), nodes - 2u);
    let part = place - vec3f(node);
    let at = first + node.x + nodes.x * (node.y + nodes.y * node.z);
    let row = nodes.x;
    let plane = nodes.x * nodes.y;
    let low = vec4f(fields[at], fields[at + row], fields[at + plane], fields[at + plane + row]);
    let high = vec4f(fields[at + 1u], fields[at + row + 1u], fields[at + plane + 1u], fields[at + plane + row + 1u]);
    let slopes = high - low;
    let along_x = low + part.x * slopes;
    let pair = mix(along_x.xz, along_x.yw, part.yy);
    let sloped = mix(slopes.xz, slopes.yw, part.yy);
    let gradient = vec3f(
        mix(sloped.x, sloped.y, part.z),
        mix(along_x.y - along_x.x, along_x.w - along_x.z, part.z),
        pair.y - pair.x,
    );
    let l = length(gradient);
    return vec4f(select(vec3f(0.0, 0.0, 1.0), gradient / l, l > 0.0), mix(pair.x, pair.y, part.z));
}

// Returns the gradient of the signed distance of a mesh's own point, and the distance, in the mesh's unit. Outside of the
// samples it is a lower bound.
fn distance_to_mesh(field: u32, p: vec3f) -> vec4f {
    let origin = vec3f(fields[field], fields[field + 1u], fields[field + 2u]);
    let cell = fields[field + 3u];
    let nodes = vec3u(vec3f(fields[field + 4u], fields[field + 5u], fields[field + 6u]));
    let least = fields[field + 7u];
    let place = (p - origin) / cell;
    let nearest = clamp(place, vec3f(), vec3f(nodes - 1u));
    let here = interpolated(field + 8u, nodes, nearest);
    if all(place == nearest) {
        return here;
    }
    let beyond = (place - nearest) * cell;
    let away = length(beyond);
    if here.w - away > away + least {
        return vec4f(here.xyz, here.w - away);
    }
    return vec4f(select(vec3f(0.0, 0.0, 1.0), beyond / away, away > 0.0), away + least);
}

// Returns the gradient of the signed distance of a body's own point, and the distance.
fn distance_to(body: Body, p: vec3f) -> vec4f {
    switch body.kind {
        case 2u: {
            return around(p, body.sizes.x);
        }
        case 3u: {
            return around(p - vec3f(0.0, 0.0, clamp(p.z, -body.sizes.y, body.sizes.y)), body.sizes.x);
        }
        case 4u: {
            let signs = select(vec3f(1.0), vec3f(-1.0), p < vec3f());
            let beyond = abs(p) - body.sizes;
            let outside = max(beyond, vec3f());
            let l = length(outside);
            if l > 0.0 {
                return vec4f(outside / l * signs, l);
            }
            let most = max(beyond.x, max(beyond.y, beyond.z));
            if beyond.x == most {
                return vec4f(signs.x, 0.0, 0.0, most);
            }
            if beyond.y == most {
                return vec4f(0.0, signs.y, 0.0, most);
            }
            return vec4f(0.0, 0.0, signs.z, most);
        }
        case 5u: {
            let surface = distance_to_mesh(body.field, p / body.sizes.x);
            return vec4f(surface.xyz, body.sizes.x * surface.w + body.sizes.y);
        }
        default: {
            return vec4f(0.0, 0.0, 1.0, p.z);
        }
    }
}

// Returns the radius of a ball around the origin that holds the body.
fn reach_of(body: Body) -> f32 {
    switch body.kind {
        case 2u: {
            return body.sizes.x;
        }
        case 3u: {
            return body.sizes.x + body.sizes.y;
        }
        case 4u: {
            return length(body.sizes);
        }
        case 5u: {
            return body.sizes.z;
        }
        default: {
            return 1e30;
        }
    }
}
