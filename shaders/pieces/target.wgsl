
// Returns component c of where a handle must be, by its slot, from the kernel's binding targets [handles, 3].
fn target_of(slot: u32, c: u32) -> f32 {
    // Slots are data: one that names no target must not lead out of the array.
    return targets[3u * min(slot - 1u, arrayLength(&targets) / 3u - 1u) + c];
}
