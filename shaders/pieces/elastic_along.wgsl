
// Returns what the edge to particle q, of this damping, adds to n . D n, if the cloth has it.
fn of_edge(b: u32, own: vec3f, q: u32, normal: vec3f, factor: f32, damping: f32) -> f32 {
    if !has(b, q) {
        return 0.0;
    }
    let edge = position(b, q) - own;
    let l = length(edge);
    if !(l > 0.0) {
        return 0.0;
    }
    let cosine = dot(edge, normal) / l;
    let along = cosine * cosine;
    return 2.0 * factor * ((1.0 + damping) * along + max(1.0 - 1.0 / l, 0.0) * (1.0 - along));
}

// Returns n . D n, with the block D of particle p in the Hessian of the stretch at the start of the frame, where compressed
// edges count as unstretched and all as stiff as the material, from the kernel's `position` and `has`, binding cloths [B], and parameters rows and columns.
fn elastic_along(b: u32, p: u32, normal: vec3f) -> f32 {
    let h = params.rows;
    let w = params.columns;
    let i = p / w;
    let j = p % w;
    let own = position(b, p);
    let stretch = cloths[b].material.x * cloths[b].weave.xy;
    let vertical = stretch.x / ((f32(h) - 1.0) * f32(w));
    let horizontal = stretch.y / (f32(h) * (f32(w) - 1.0));
    let damping = cloths[b].gravity.w;
    var sum = 0.0;
    if i > 0u {
        sum += of_edge(b, own, p - w, normal, vertical, damping);
    }
    if i + 1u < h {
        sum += of_edge(b, own, p + w, normal, vertical, damping);
    }
    if j > 0u {
        sum += of_edge(b, own, p - 1u, normal, horizontal, damping);
    }
    if j + 1u < w {
        sum += of_edge(b, own, p + 1u, normal, horizontal, damping);
    }
    return sum;
}
