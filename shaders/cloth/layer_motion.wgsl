// Where the particles of a cloth are and how they move in a frame, as far as it is known, and how large the cells must be in
// which parts of the cloth that may touch are searched (`cpu::cloth::Layers`).
//
// The way is base at the start of a frame, and then the pairs of every particle are wanted. With ENDS it is base + a, that
// which the frame took, and pairs are wanted of particles that have left the way at the start by more than a budget.
// Ways are relative to that of the mean particle.
//
// cloths: [B]
// marks: [B, n]
// x, base, a: [B, 3, n]
// motion: [B, n, 2] of (place, mass of a free particle, 0 for a handle, -1 outside of the
//   cloth), (way, flags of the patch, see `shaders/pieces/patch.wgsl`)
// extents: [B] of (cells per edge, distance within which pairs are contacts, what the reach of a patch adds to its own
//   size and way, distance at which a pair has met)
//
// One workgroup per cloth. Workgroups: (B).
// Adjoint: none, training has no self-contact.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> x: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> a: array<f32>;
@group(0) @binding(6) var<storage, read_write> motion: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> extents: array<vec4f>;

override ENDS: bool = false;

const LANES: u32 = 256u;
const MARGIN: f32 = 0.25;
const BUDGET: f32 = 0.85;
const NEAR: f32 = 0.5;

// Of each invocation, then of all: sums of base and of what is added to it, and later the largest sizes and ways.
var<workgroup> bases: array<vec3f, LANES>;
var<workgroup> added: array<vec3f, LANES>;

fn of_field(b: u32, p: u32) -> vec3f {
    let n = params.rows * params.columns;
    let at = b * 3u * n + p;
    return vec3f(base[at], base[at + n], base[at + 2u * n]);
}

// Returns what particle p adds to its way by the velocity.
fn addition(b: u32, p: u32) -> vec3f {
    let n = params.rows * params.columns;
    if !ENDS || !is_free(marks[b * n + p]) {
        return vec3f();
    }
    let at = b * 3u * n + p;
    return vec3f(a[at], a[at + n], a[at + 2u * n]);
}

// Returns which parts of the patch of particle p the cloth has.
fn parts_of(b: u32, p: u32) -> u32 {
    let n = params.rows * params.columns;
    let w = params.columns;
    let mark = marks[b * n + p];
    let own = !is_outside(mark);
    let right = own && p % w + 1u < w && !is_outside(marks[b * n + min(p + 1u, n - 1u)]);
    let down = own && p + w < n && !is_outside(marks[b * n + min(p + w, n - 1u)]);
    return select(0u, RIGHT, right) | select(0u, DOWN, down) | select(0u, WHOLE, begins_cell(mark));
}

@compute @workgroup_size(256)
fn layer_motion(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.x;
    let n = params.rows * params.columns;
    let thickness = cloths[b].layers.x;
    var of_base = vec3f();
    var of_added = vec3f();
    for (var p = lane; p < n; p += LANES) {
        of_base += of_field(b, p);
        of_added += addition(b, p);
    }
    bases[lane] = of_base;
    added[lane] = of_added;
    for (var half = LANES / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            bases[lane] += bases[lane + half];
            added[lane] += added[lane + half];
        }
    }
    workgroupBarrier();
    let mean_base = bases[0] / f32(n);
    let mean_added = added[0] / f32(n);
    let budget = 0.5 * BUDGET * (thickness + MARGIN);
    for (var p = lane; p < n; p += LANES) {
        let at = b * 3u * n + p;
        let left = addition(b, p) - mean_added;
        let wanted = select(0u, WANTED, !ENDS || length(left) > budget);
        let mark = marks[b * n + p];
        let m = select(select(0.0, mass_of(mark), is_free(mark)), -1.0, is_outside(mark));
        motion[2u * (b * n + p)] = vec4f(x[at], x[at + n], x[at + 2u * n], m);
        motion[2u * (b * n + p) + 1u] = vec4f(of_field(b, p) - mean_base + left, f32(wanted | parts_of(b, p)));
    }
    storageBarrier();
    workgroupBarrier();
    var largest = vec2f();
    for (var p = lane; p < n; p += LANES) {
        let ball = patch_ball(b, p);
        let sizes = vec2f(ball.size, length(ball.way));
        // Patches that are nowhere have no pairs.
        if is_within_reach(vec3f(sizes, 0.0)) && is_within_reach(ball.centre) {
            largest = max(largest, sizes);
        }
    }
    bases[lane] = vec3f(largest, 0.0);
    for (var half = LANES / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            bases[lane] = max(bases[lane], bases[lane + half]);
        }
    }
    if lane == 0u {
        let range = select(thickness + MARGIN, NEAR * thickness, ENDS);
        let most = bases[0].x + bases[0].y;
        extents[b] = vec4f(1.0 / (range + 2.0 * most), range, range + most, NEAR * thickness);
    }
}
