
// A cloth drawn from a pool for a training step.
struct Drawn {
    slot: u32, // index in the pool
    begin: u32, // 1 if the cloth is reset
    advance: u32, // 1 if the frame ends after this iteration
    keep: f32, // share of the velocity kept at the end of the frame
    rotation: array<vec4f, 3>, // rows of the matrix that rotates the sheet at rest to its initial pose
}
