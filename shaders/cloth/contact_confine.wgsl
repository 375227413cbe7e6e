// After a step: moves particles that are too near to a body out (`terms/contact`), which counts as a part of the step.
//
// contacts: [B, SLOTS, n]
// given: base [B, 3, n], and more
// a: [B, 3, n]
// last_step: with STEPS a field [B, 3, n] from element `first_step` on
// fields: with REMEMBERS another one from element `first_field` on
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, training has no bodies.

struct Params {
    particles: u32, // n
    first_step: u32,
    first_field: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> contacts: array<Contact>;
@group(0) @binding(2) var<storage, read> given: array<f32>;
@group(0) @binding(3) var<storage, read_write> a: array<f32>;
@group(0) @binding(4) var<storage, read_write> last_step: array<f32>;
@group(0) @binding(5) var<storage, read_write> fields: array<f32>;

override SLOTS: u32 = 1;
override STEPS: bool = false;
override REMEMBERS: bool = false;

@compute @workgroup_size(64)
fn contact_confine(
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
    let before = displacement(b, p, n);
    var y = before;
    for (var k = 0u; k < SLOTS; k++) {
        y += contact_way_out(contacts[(b * SLOTS + k) * n + p], y);
    }
    let moved = y - before;
    if all(moved == vec3f()) {
        return;
    }
    for (var c = 0u; c < 3u; c++) {
        let at = (b * 3u + c) * n + p;
        a[at] += moved[c];
        if STEPS {
            last_step[params.first_step + at] += moved[c];
        }
        if REMEMBERS {
            fields[params.first_field + at] += moved[c];
        }
    }
}
