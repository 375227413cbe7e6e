
// Two parts of a cloth that may touch, a particle and a triangle or two edges, and the contact that their relative
// displacement y = sum w_k y_k has (`cpu::cloth::Layers`).
struct Pair {
    particles: vec4u, // numbers, with HELD for handles
    weights: vec4f, // w, which sum to 0
    contact: Contact,
}

const HELD: u32 = 0x80000000u;
