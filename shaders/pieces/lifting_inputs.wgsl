
// Inputs of the lifting: its hidden units, computed on the fly.
const LIFTING: bool = true;

// Only blocks have inputs in memory.
fn input(_sample: u32, _i: u32, _row: u32, _quad: u32) -> vec4f {
    return vec4f();
}

// Only blocks pool.
fn keep_largest(_at: u32, _largest: f32) {}
