// Start of a frame of a subspace method: shortens the axes of the sheet (`sheet_axes`) at the particles that bodies hold.
//
// With the sum r of what its contacts resist (`terms/contact`), a particle's t1, t2 and normal become
// (1 + HOLDING n r)^(-1/2) of what they were.
//
// contacts: [B, SLOTS, n]
// a: [B, 3, n]
// given: base [B, 3, n], and more
// axes: [B, 16, n], of which the first nine change
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    particles: u32, // n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> contacts: array<Contact>;
@group(0) @binding(2) var<storage, read> a: array<f32>;
@group(0) @binding(3) var<storage, read> given: array<f32>;
@group(0) @binding(4) var<storage, read_write> axes: array<f32>;

override SLOTS: u32 = 1;
override HOLDING: f32 = 1e-3;

@compute @workgroup_size(64)
fn contact_axes(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.particles;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let b = group.z;
    if p >= n {
        return;
    }
    let y = displacement(b, p, n);
    var resistance = 0.0;
    for (var k = 0u; k < SLOTS; k++) {
        resistance += contact_resistance(contacts[(b * SLOTS + k) * n + p], y);
    }
    let share = inverseSqrt(1.0 + HOLDING * f32(n) * resistance);
    for (var c = 0u; c < 9u; c++) {
        axes[(b * 16u + c) * n + p] *= share;
    }
}
