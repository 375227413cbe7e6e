
// Returns the barycentric coordinates of the point of a triangle that is nearest to the origin, by the regions of its
// corners and sides.
fn nearest_on_triangle(a: vec3f, b: vec3f, c: vec3f) -> vec3f {
    let ab = b - a;
    let ac = c - a;
    let d1 = -dot(ab, a);
    let d2 = -dot(ac, a);
    if d1 <= 0.0 && d2 <= 0.0 {
        return vec3f(1.0, 0.0, 0.0);
    }
    let d3 = -dot(ab, b);
    let d4 = -dot(ac, b);
    if d3 >= 0.0 && d4 <= d3 {
        return vec3f(0.0, 1.0, 0.0);
    }
    let of_c = d1 * d4 - d3 * d2;
    if of_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let share = d1 / (d1 - d3);
        return vec3f(1.0 - share, share, 0.0);
    }
    let d5 = -dot(ab, c);
    let d6 = -dot(ac, c);
    if d6 >= 0.0 && d5 <= d6 {
        return vec3f(0.0, 0.0, 1.0);
    }
    let of_b = d5 * d2 - d1 * d6;
    if of_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let share = d2 / (d2 - d6);
        return vec3f(1.0 - share, 0.0, share);
    }
    let of_a = d3 * d6 - d5 * d4;
    if of_a <= 0.0 && d4 >= d3 && d5 >= d6 {
        let share = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return vec3f(0.0, 1.0 - share, share);
    }
    return vec3f(of_a, of_b, of_c) / (of_a + of_b + of_c);
}

// Returns how far along u and v two lines that begin r apart are nearest to each other, and 1; zeros if they are parallel.
fn nearest_on_lines(u: vec3f, v: vec3f, r: vec3f) -> vec3f {
    let uu = dot(u, u);
    let vv = dot(v, v);
    let uv = dot(u, v);
    let ur = dot(u, r);
    let vr = dot(v, r);
    let determinant = uu * vv - uv * uv;
    if determinant <= 1e-6 * uu * vv {
        return vec3f();
    }
    return vec3f((uv * vr - vv * ur) / determinant, (uu * vr - uv * ur) / determinant, 1.0);
}

// Returns top / bottom between 0 and 1; 0 without a bottom.
fn share_of(top: f32, bottom: f32) -> f32 {
    return select(0.0, clamp(top / bottom, 0.0, 1.0), bottom > 0.0);
}

// Returns the distance of two edges along u and v that begin r apart.
fn distance_of_edges(u: vec3f, v: vec3f, r: vec3f) -> f32 {
    let uu = dot(u, u);
    let vv = dot(v, v);
    let uv = dot(u, v);
    let ur = dot(u, r);
    let vr = dot(v, r);
    // Of parallel edges any point is as good to begin with.
    let first = clamp(nearest_on_lines(u, v, r).x, 0.0, 1.0);
    let s = share_of(uv * share_of(uv * first + vr, vv) - ur, uu);
    let t = share_of(uv * s + vr, vv);
    return length(r + s * u - t * v);
}
