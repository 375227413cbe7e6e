
// Returns whether a number is neither infinite nor NaN. Compares exponent bits, because not every compiler
// preserves comparisons with NaN.
fn is_finite(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7f800000u) != 0x7f800000u;
}
