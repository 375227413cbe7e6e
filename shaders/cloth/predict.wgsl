// Start of a frame: sets a = 0 and base, the displacement at a = 0:
//   base = v at a free particle, target - x at a handle, 0 outside of the cloth
// Within a frame (FRESH false), a keeps its value.
//
// x, v, base, a: [B, 3, n]
// marks: [B, n]
// targets: [handles, 3]
//
// One invocation per component of a particle. Workgroups: (n / 64 over x and y, 3 B in z).
// Adjoint: none, the state is a constant of the training step.

struct Params {
    particles: u32, // n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> v: array<f32>;
@group(0) @binding(3) var<storage, read> marks: array<vec2u>;
@group(0) @binding(4) var<storage, read> targets: array<f32>;
@group(0) @binding(5) var<storage, read_write> base: array<f32>;
@group(0) @binding(6) var<storage, read_write> a: array<f32>;

override FRESH: bool = true;

@compute @workgroup_size(64)
fn predict(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.particles {
        return;
    }
    let at = group.z * params.particles + p;
    let mark = marks[group.z / 3u * params.particles + p];
    var displacement = v[at];
    if is_outside(mark) {
        displacement = 0.0;
    } else if !is_free(mark) {
        displacement = target_of(slot_of(mark), group.z % 3u) - x[at];
    }
    base[at] = displacement;
    if FRESH {
        a[at] = 0.0;
    }
}
