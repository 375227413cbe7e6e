
// A body and how it moves in a frame (`cloth::Body`, `cloth::Sweep`), in grid units.
struct Body {
    sizes: vec3f,
    kind: u32, // 0 none, 1 plane, 2 sphere, 3 capsule, 4 box
    thickness: f32,
    friction: f32,
    padding: vec2f,
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
        default: {
            return 1e30;
        }
    }
}
