// Energy terms and stretch of a cloth, in partial sums over its particles (`cloth::EnergyTerms`, the terms in
// `shaders/terms`).
//
// Each particle owns the edges, corner angles and bends that start at it, as far as the cloth has them. A part holds eight numbers:
// stretch, shear, bend, inertia, external (weighted as in the energy), largest |edge| - 1, sum of
// ||edge| - 1|, and repulsion, which is 0 here (see `repulsion`).
//
// cloths: [B]
// marks: [B, H, W]
// a, x: [B, 3, H, W]
// base: [B, 3, H, W], and the external accelerations [B, 3, H, W] from element `first_external` on
// rest_angles: [B, H, W], along the height and along the width; not read if the cloths have none
// parts: [B, groups, 8]
//
// One invocation per particle. Sums over a workgroup have a fixed order.
// Workgroups: (n / 64 over x and y, B in z).
// Adjoint: `gradient`.

struct Params {
    rows: u32, // H
    columns: u32, // W
    groups: u32,
    first_external: u32,
    has_rest_angles: u32,
    zero: u32, // 0
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read> rest_angles: array<vec2f>;
@group(0) @binding(7) var<storage, read_write> parts: array<vec4f>;

const RIGHT_ANGLE: f32 = 1.5707963267948966;

var<workgroup> terms: array<vec4f, 64>; // stretch, shear, bend, inertia
var<workgroup> others: array<vec4f, 64>; // external, largest stretch, sum of |stretch|, unused

// Returns the factor of the stiffness at particle (i, j), 0 if the cloth has none.
fn stiffness(b: u32, i: u32, j: u32) -> f32 {
    if i >= params.rows || j >= params.columns {
        return 0.0;
    }
    return stiffness_of(marks[b * params.rows * params.columns + i * params.columns + j]);
}

// Returns the stretch of an edge, given its length less 1, its vector at the start of the frame, and the stiffness at its ends.
fn edge_energy(off: f32, before: vec3f, damping: f32, ends: vec2f) -> f32 {
    var energy = off * off;
    if damping > 0.0 {
        energy += damping_of(off, damping, length(before));
    }
    return 0.5 * (ends.x + ends.y) * energy;
}

// Returns the start of particle (i, j).
fn start(b: u32, i: u32, j: u32) -> vec3f {
    let n = params.rows * params.columns;
    let at = b * 3u * n + i * params.columns + j;
    return vec3f(x[at], x[at + n], x[at + 2u * n]);
}

// Returns the position of particle (i, j) relative to `own`.
fn position(b: u32, i: u32, j: u32, own: Trial) -> vec3f {
    let other = trial(b, i * params.columns + j, params.rows * params.columns);
    return offset(other.x, own.x, other.shift, own.shift, params.zero);
}

// Returns the energy of a corner angle at a particle of this stiffness over its coefficient; zero if it does not exist.
fn corner_energy(u: vec3f, w: vec3f, exists: bool, stiffness: f32) -> f32 {
    if !exists {
        return 0.0;
    }
    return stiffness * squared_angle(u, w, RIGHT_ANGLE);
}

@compute @workgroup_size(64)
fn energy(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let part = group.y * groups.x + group.x;
    let p = part * 64u + lane;
    let b = group.z;
    var term = vec4f();
    var other = vec4f(0.0, -1.0, 0.0, 0.0);
    if p < n {
        let i = p / params.columns;
        let j = p % params.columns;
        let rows = f32(params.rows);
        let columns = f32(params.columns);
        let here = stiffness(b, i, j);
        let below = stiffness(b, i + 1u, j);
        let right = stiffness(b, i, j + 1u);
        let opposite = stiffness(b, i + 1u, j + 1u);
        let has_down = here > 0.0 && below > 0.0;
        let has_across = here > 0.0 && right > 0.0;
        let material = cloths[b].material;
        let weave = cloths[b].weave;
        let damping = cloths[b].gravity.w;
        let at = b * 3u * n + p;
        let own = trial(b, p, n);
        // Of the cell behind it, as far as the grid goes.
        let last_row = params.rows - 1u;
        let last_column = params.columns - 1u;
        let down = position(b, min(i + 1u, last_row), j, own);
        let across = position(b, i, min(j + 1u, last_column), own);
        if has_down {
            let off = stretch_of(down);
            let energy = edge_energy(off, start(b, i + 1u, j) - own.x, damping, vec2f(here, below));
            term.x += weave.x * energy / ((rows - 1.0) * columns);
            other.y = max(other.y, off);
            other.z += abs(off);
            if stiffness(b, i + 2u, j) > 0.0 {
                term.z += weave.z * below * squared_angle(down, position(b, i + 2u, j, own) - down, 0.0);
            }
        }
        if has_across {
            let off = stretch_of(across);
            let energy = edge_energy(off, start(b, i, j + 1u) - own.x, damping, vec2f(here, right));
            term.x += weave.y * energy / (rows * (columns - 1.0));
            other.y = max(other.y, off);
            other.z += abs(off);
            if stiffness(b, i, j + 2u) > 0.0 {
                term.z += weave.w * right * squared_angle(across, position(b, i, j + 2u, own) - across, 0.0);
            }
        }
        let corner = position(b, min(i + 1u, last_row), min(j + 1u, last_column), own);
        let far_v = corner - across;
        let far_h = corner - down;
        let has_far_v = right > 0.0 && opposite > 0.0;
        let has_far_h = below > 0.0 && opposite > 0.0;
        term.y += corner_energy(down, across, has_down && has_across, here)
            + corner_energy(down, far_h, has_down && has_far_h, below)
            + corner_energy(far_v, across, has_far_v && has_across, right)
            + corner_energy(far_v, far_h, has_far_v && has_far_h, opposite);
        let acceleration = vec3f(a[at], a[at + n], a[at + 2u * n]);
        let given = params.first_external + at;
        let f = vec3f(base[given], base[given + n], base[given + 2u * n]);
        let count = rows * columns;
        term *= vec4f(material.x, material.y / count, material.z / count, 0.0);
        if params.has_rest_angles != 0u {
            term.z += hinge_energy(hinge(b, vec2i(i32(i), i32(j)), 0u)) + hinge_energy(hinge(b, vec2i(i32(i), i32(j)), 1u));
        }
        let alone = particle_energies(acceleration, f, mass_of(marks[b * n + p]) / count);
        term.w = alone.x;
        other.x = alone.y;
    }
    terms[lane] = term;
    others[lane] = other;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            terms[lane] += terms[lane + half];
            let more = others[lane + half];
            let less = others[lane];
            others[lane] = vec4f(less.x + more.x, max(less.y, more.y), less.z + more.z, 0.0);
        }
    }
    if lane == 0u && part < params.groups {
        let out = 2u * (b * params.groups + part);
        parts[out] = terms[0];
        parts[out + 1u] = others[0];
    }
}
