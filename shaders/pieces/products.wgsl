
// Sums of products along the K directions of a kernel, which binds `directions` [K, slot] with `params.slot`.

// The upper triangle of A, row by row.
var<private> curvature0: vec4f;
var<private> curvature1: vec4f;
var<private> curvature2: vec2f;

// Adds v_i w_j to A_ij for i <= j. Callers add pairs of products whose sum is symmetric.
fn add_products(v: vec4f, w: vec4f) {
    curvature0 += v.x * w;
    curvature1 += v.yyyz * w.yzwz;
    curvature2 += v.zw * w.w;
}

// Returns one number of each direction, 0 for those from K on.
fn of_directions(at: u32) -> vec4f {
    var v = vec4f(directions[at], directions[params.slot + at], directions[2u * params.slot + at], 0.0);
    if K == 4u {
        v.w = directions[3u * params.slot + at];
    }
    return v;
}
