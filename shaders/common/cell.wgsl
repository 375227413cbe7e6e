
// The cube of space that a place is in, of so many to an edge.
fn cell_of(place: vec3f, per_edge: f32) -> vec3i {
    return vec3i(floor(place * per_edge));
}

// The bucket of a cell among mask + 1, a power of two; cells that are far apart may share one.
fn bucket_of(cell: vec3i, mask: u32) -> u32 {
    let c = bitcast<vec3u>(cell);
    return ((c.x * 73856093u) ^ (c.y * 19349663u) ^ (c.z * 83492791u)) & mask;
}

// Whether a place is less than a million edges (2^20) away along each axis: what lies beyond, or is no number, is near nothing. By its
// exponents, as not every compiler keeps comparisons with what is no number.
fn is_within_reach(place: vec3f) -> bool {
    return all((bitcast<vec3u>(place) & vec3u(0x7f800000u)) < vec3u(0x49800000u));
}
