
// Returns whether an edge of the triangulated grid joins two particles, or they are the same.
fn joined(p: u32, q: u32, columns: u32) -> bool {
    let last = max(p, q);
    let apart = last - min(p, q);
    // Along a row or a diagonal, unless it wraps from the end of one row to the start of another.
    let along = apart == 1u || apart == columns + 1u;
    return apart == 0u || apart == columns || (along && last % columns != 0u);
}
