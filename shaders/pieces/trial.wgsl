
// A particle of the trial: its start, what the trial moves it by (base + a, or base alone at a handle, whose way is prescribed),
// and its acceleration.
struct Trial {
    x: vec3f,
    shift: vec3f,
    a: vec3f,
    held: bool,
}

// Particle p of cloth b, of n; reads what a kernel binds as slots [B, n] and x, base, a [B, 3, n].
fn trial(b: u32, p: u32, n: u32) -> Trial {
    let at = b * 3u * n + p;
    let held = slots[b * n + p] != 0u;
    let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
    let way = vec3f(base[at], base[at + n], base[at + 2u * n]);
    let start = vec3f(x[at], x[at + n], x[at + 2u * n]);
    return Trial(start, way + select(acceleration, vec3f(), held), acceleration, held);
}

// Where a particle is, seen from another one. Differences of neighbouring coordinates are exact or nearly so; absolute positions
// would round the stiff edges by the size of the coordinates. Metal and DirectX may add up in another order, x + shift first, which
// is that rounding: a zero that only the host knows (`zero`) keeps the first difference apart.
fn offset(other: Trial, own: Trial, zero: u32) -> vec3f {
    let apart = bitcast<vec3f>(bitcast<vec3u>(other.x - own.x) ^ vec3u(zero));
    return apart + (other.shift - own.shift);
}
