
// A particle of the trial: its position at the start of the frame and its displacement, base + a for a free
// particle, base alone for the others, whose motion is prescribed.
struct Trial {
    x: vec3f,
    shift: vec3f,
}

// Returns particle p of cloth b, out of n, from the kernel's bindings marks [B, n] and x, base, a [B, 3, n].
fn trial(b: u32, p: u32, n: u32) -> Trial {
    let at = b * 3u * n + p;
    let free = is_free(marks[b * n + p]);
    let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
    let displacement = vec3f(base[at], base[at + n], base[at + 2u * n]);
    let shift = displacement + select(vec3f(), acceleration, free);
    return Trial(vec3f(x[at], x[at + n], x[at + 2u * n]), shift);
}
