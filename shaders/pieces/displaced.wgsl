
// Returns the displacement of particle p of cloth b, out of n, from the kernel's bindings a [B, 3, n] and given, which
// begins with base [B, 3, n]. It is not that of a handle, which has no contacts.
fn displacement(b: u32, p: u32, n: u32) -> vec3f {
    let at = b * 3u * n + p;
    return vec3f(given[at] + a[at], given[at + n] + a[at + n], given[at + 2u * n] + a[at + 2u * n]);
}
