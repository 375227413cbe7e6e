// The couples that bend the cloths to their angles at rest (`cpu::cloth::Couples`): the acceleration that they add to the
// external one, and their energy in partial sums over the particles of a cloth.
//
// With the axis d of a particle's couple and its moment M, an edge e at the particle feels the force
//   M d x e / |d x e|^2
// at its far end, and the opposite at the particle.
//
// cloths: [B]
// marks: [B, H, W]
// rest_angles: [B, H, W], along the height and along the width
// x, a: [B, 3, H, W]
// base: [B, 3, H, W]; the accelerations without the couples [B, 3, H, W] from element `first_source` on, and those
//   with them from `first_total` on, which may be the same
// parts: [B, groups, 8], of which the last number is increased, or with SETS set
//
// One invocation per particle, which gathers from the couples at itself and at its four neighbours.
// Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, the cloths of training are flat at rest.

struct Params {
    rows: u32, // H
    columns: u32, // W
    groups: u32,
    first_source: u32,
    first_total: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> rest_angles: array<vec2f>;
@group(0) @binding(4) var<storage, read> x: array<f32>;
@group(0) @binding(5) var<storage, read> a: array<f32>;
@group(0) @binding(6) var<storage, read_write> base: array<f32>;
@group(0) @binding(7) var<storage, read_write> parts: array<f32>;

override SETS: bool = true;

// Returns the force of a couple on the far end of one of its edges.
fn push(one: Hinge, edge: vec3f) -> vec3f {
    let across = cross(one.axis, edge);
    return across * (one.moment / max(dot(across, across), NEAREST));
}

@compute @workgroup_size(64)
fn couple(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let part = group.y * groups.x + group.x;
    let p = part * 64u + lane;
    let b = group.z;
    var energy = 0.0;
    if p < n {
        let own = vec2i(i32(p / params.columns), i32(p % params.columns));
        var force = vec3f();
        for (var axis = 0u; axis < 2u; axis++) {
            let along = step_along(axis);
            let here = hinge(b, own, axis);
            energy += hinge_energy(here);
            force -= push(here, here.before) + push(here, here.after);
            let next = hinge(b, own + along, axis);
            force += push(next, next.before);
            let last = hinge(b, own - along, axis);
            force += push(last, last.after);
        }
        let added = accelerated(force, marks[b * n + p], n);
        let at = b * 3u * n + p;
        for (var c = 0u; c < 3u; c++) {
            base[params.first_total + at + c * n] = base[params.first_source + at + c * n] + added[c];
        }
    }
    put_energy(b, part, lane, energy);
}
