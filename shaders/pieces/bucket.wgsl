
// Returns where a bucket of cloth b begins among its sorted particles, from the kernel's binding
// ends [B, buckets].
fn begin_of(b: u32, bucket: u32, buckets: u32) -> u32 {
    if bucket == 0u {
        return 0u;
    }
    return ends[b * buckets + min(bucket, buckets) - 1u];
}

// Returns where the bucket ends, at most the number of particles.
fn end_of(b: u32, bucket: u32, buckets: u32, particles: u32) -> u32 {
    return min(ends[b * buckets + min(bucket, buckets - 1u)], particles);
}
