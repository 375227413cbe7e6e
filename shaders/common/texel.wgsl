
// Returns the place of quad `at` of a tensor in texels, which number along rows.
fn texel(at: u32) -> vec2u {
    return vec2u(at % 4096u, at / 4096u);
}
