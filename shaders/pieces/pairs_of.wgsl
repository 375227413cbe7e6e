
// Returns the number of pairs of cloth b that were kept, from the kernel's binding pair_ends [B, buckets]: where the last
// bucket ends, unless that is beyond the room for pairs.
fn pairs_of(b: u32) -> u32 {
    let count = pair_ends[b * params.buckets + params.buckets - 1u];
    return select(count, 0u, count > params.room);
}
