
// A cloth of a pool that takes part in a training step.
struct Drawn {
    slot: u32, // its place in the pool
    begin: u32, // 1 where a life starts
    advance: u32, // 1 where the frame ends after this iteration
    keep: f32, // share of the velocity that is left when the frame ends
    rotation: array<vec4f, 3>, // rows of the matrix that turns the sheet at rest to its start
}
