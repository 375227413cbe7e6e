// End of a frame with bodies, after `integrate`: moves particles that are too near to a body out, and takes back the slip
// of those that stick (`terms/contact`).
//
// contacts: [B, SLOTS, n]
// x, v: [B, 3, n]; v is the displacement in the frame
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no bodies.

struct Params {
    particles: u32, // n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> contacts: array<Contact>;
@group(0) @binding(2) var<storage, read_write> x: array<f32>;
@group(0) @binding(3) var<storage, read_write> v: array<f32>;

override SLOTS: u32 = 1;

@compute @workgroup_size(64)
fn contact_end(
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
    let at = b * 3u * n + p;
    let before = vec3f(v[at], v[at + n], v[at + 2u * n]);
    var y = before;
    for (var k = 0u; k < SLOTS; k++) {
        let one = contacts[(b * SLOTS + k) * n + p];
        y += contact_slip_back(one, y) + contact_way_out(one, y);
    }
    let moved = y - before;
    for (var c = 0u; c < 3u; c++) {
        x[at + c * n] += moved[c];
        v[at + c * n] += moved[c];
    }
}
