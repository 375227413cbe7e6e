
// Returns the cubic cell that contains a position, with `per_edge` cells to the length of an edge.
fn cell_of(place: vec3f, per_edge: f32) -> vec3i {
    return vec3i(floor(place * per_edge));
}

// Returns the bucket of a cell among mask + 1, a power of two. Cells that are far apart may share a bucket.
fn bucket_of(cell: vec3i, mask: u32) -> u32 {
    let c = bitcast<vec3u>(cell);
    return ((c.x * 73856093u) ^ (c.y * 19349663u) ^ (c.z * 83492791u)) & mask;
}

// Returns whether a position is less than a million edges (2^20) from the origin along each axis. Positions
// beyond that, infinities and NaNs have no neighbours. Compares exponent bits, because not every compiler
// preserves comparisons with NaN.
fn is_within_reach(place: vec3f) -> bool {
    return all((bitcast<vec3u>(place) & vec3u(0x7f800000u)) < vec3u(0x49800000u));
}
