// The step of a subspace method: keeps or takes back the last step, then minimises the quadratic model of the
// energy over the span of four directions (`curvature`).
//
// At the start of a frame (stage 0) only the last frame's acceleration p_2 and what extrapolates it, p_1, are directions, and
// the step is the point h WARMEST p_2 + f p_1 of the triangle 0 <= f <= h <= 1 where the model is least. Later an iterate is
// accepted if E <= E_before + 1e-6 max(size, size_before), where size is the sum of the magnitudes of the energy's terms. Then, with f_i = 1 / |p_i|, A'_ij = f_i f_j
// A_ij, b'_i = f_i b_i and A' = V diag(l) V^T,
//   c = -f V diag(1 / max(|l|, 1e-7 max |l|)) V^T b',  step = sum_i c_i p_i,  a += step,  p_2 = step
// Directions that are 0 or not finite are left out. If A' is 0 there is no step. An iterate that is not
// accepted goes back to a fraction of the last step: that at which the parabola through the energies at its ends
// with the slope b . c at its start is least, 0.1 to 0.5. After the last iteration (stage 2) an accepted iterate
// stays, and one that is not goes back by all of it.
//
// parts: [B, parts, 24], see `curvature`
// energy_parts: [B, groups, 8], the repulsion last (`energy`); only with REPELS
// directions: [K, slot], [B, 3 n] each; beyond K, parts are 0
// a: [B, 3 n]
// state: [rows, B, 5] = accepted energy, its size, slope of the step from there, shortened steps and non-finite
//   directions of this frame; row `before` leads to row `after`
// fields: with REMEMBERS the step also goes to [B, 3 n] from element `last_step` on
//
// One invocation per element of a cloth, or several. Each workgroup adds up the parts and solves for itself.
// Workgroups: (at most 3 n / 256, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    elements: u32, // 3 n
    slot: u32, // elements from a direction to the next, at least 3 B n
    parts: u32,
    groups: u32,
    batch: u32, // B
    before: u32,
    after: u32,
    stage: u32, // 0 at the start of a frame, 1 in an iteration, 2 at the end
    last_step: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> parts: array<vec4f>;
@group(0) @binding(2) var<storage, read> energy_parts: array<f32>;
@group(0) @binding(3) var<storage, read_write> directions: array<f32>;
@group(0) @binding(4) var<storage, read_write> a: array<f32>;
@group(0) @binding(5) var<storage, read_write> state: array<f32>;
@group(0) @binding(6) var<storage, read_write> fields: array<f32>;

override REPELS: bool = false;
override REMEMBERS: bool = false;
override WARMEST: f32 = 0.5;

// Relative errors of the energy, and of an eigenvalue.
const ENERGY_ERROR: f32 = 1e-6;
const EIGENVALUE_ERROR: f32 = 1e-7;

// Sums of 32 slices of the parts, six quads each.
var<workgroup> sums: array<vec4f, 192>;
var<workgroup> repulsions: array<f32, 256>;
// What all invocations do: 0 nothing, 1 a step of these coefficients, 2 back to a fraction of the last step.
var<workgroup> what: u32;
var<workgroup> coefficients: vec4f;
var<workgroup> fraction: f32;

fn add_up(b: u32, lane: u32) {
    if lane < 192u {
        var sum = vec4f();
        for (var k = lane / 6u; k < params.parts; k += 32u) {
            sum += parts[(b * params.parts + k) * 6u + lane % 6u];
        }
        sums[lane] = sum;
    }
    if REPELS {
        var sum = 0.0;
        for (var k = lane; k < params.groups; k += 256u) {
            sum += energy_parts[(b * params.groups + k) * 8u + 7u];
        }
        repulsions[lane] = sum;
    }
    for (var half = 16u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < 6u * half {
            sums[lane] += sums[lane + 6u * half];
        }
    }
    if REPELS {
        for (var half = 128u; half > 0u; half /= 2u) {
            workgroupBarrier();
            if lane < half {
                repulsions[lane] += repulsions[lane + half];
            }
        }
    }
    workgroupBarrier();
}

fn are_finite(v: vec4f) -> vec4<bool> {
    return vec4<bool>(is_finite(v.x), is_finite(v.y), is_finite(v.z), is_finite(v.w));
}

// Returns v where it is finite, else 0.
fn finite_of(v: vec4f) -> vec4f {
    return select(vec4f(), v, are_finite(v));
}

fn largest(v: vec4f) -> f32 {
    return max(max(abs(v.x), abs(v.y)), max(abs(v.z), abs(v.w)));
}

// Returns the rotation that makes elements (0, 1) and (2, 3) of a symmetric matrix 0. Both angles are at most
// pi / 4.
fn rotation(m: mat4x4f) -> mat4x4f {
    let apart = vec2f(m[1].y - m[0].x, m[3].w - m[2].z);
    let off = 2.0 * vec2f(m[1].x, m[3].z);
    let towards = select(vec2f(-1.0), vec2f(1.0), apart >= vec2f());
    // The floor is a normal number: a device may flush subnormals to 0.
    let tangent = towards * off / max(abs(apart) + sqrt(apart * apart + off * off), vec2f(1e-37));
    let c = inverseSqrt(1.0 + tangent * tangent);
    let s = c * tangent;
    return mat4x4f(
        vec4f(c.x, -s.x, 0.0, 0.0),
        vec4f(s.x, c.x, 0.0, 0.0),
        vec4f(0.0, 0.0, c.y, -s.y),
        vec4f(0.0, 0.0, s.y, c.y),
    );
}

// Returns the product of a symmetric matrix's inverse and a vector, where each eigenvalue is replaced by its
// magnitude, at least EIGENVALUE_ERROR of the largest. The matrix must not be 0.
//
// Jacobi's method: a turn rotates two pairs of axes, then the last three axes change places, so that three
// turns rotate each pair once. No index is variable, which keeps the matrices in registers.
fn solved(matrix: mat4x4f, right: vec4f) -> vec4f {
    var m = matrix;
    var v = mat4x4f(
        vec4f(1.0, 0.0, 0.0, 0.0),
        vec4f(0.0, 1.0, 0.0, 0.0),
        vec4f(0.0, 0.0, 1.0, 0.0),
        vec4f(0.0, 0.0, 0.0, 1.0),
    );
    for (var turn = 0u; turn < 18u; turn++) {
        let r = rotation(m);
        m = transpose(r) * m * r;
        v = v * r;
        m = mat4x4f(m[0].xzwy, m[2].xzwy, m[3].xzwy, m[1].xzwy);
        v = mat4x4f(v[0], v[2], v[3], v[1]);
    }
    let l = abs(vec4f(m[0].x, m[1].y, m[2].z, m[3].w));
    return v * ((transpose(v) * right) / max(l, vec4f(EIGENVALUE_ERROR * largest(l))));
}

// The coefficients of a step, and the number of directions that are not finite.
struct Solution {
    coefficients: vec4f,
    dropped: f32,
}

// Minimises the quadratic model, from the sums of the parts.
fn minimum() -> Solution {
    let q0 = sums[0];
    let q1 = sums[1];
    let q2 = sums[2];
    let q3 = sums[3];
    let slopes = vec4f(q2.zw, q3.xy);
    let squares = vec4f(q3.zw, sums[4].xy);
    let finite = are_finite(squares) & are_finite(slopes) & are_finite(vec4f(q0.x, q1.x, q1.w, q2.y));
    let dropped = dot(vec4f(1.0), select(vec4f(1.0), vec4f(), finite));
    let kept = finite & (squares > vec4f());
    let f = select(vec4f(), 1.0 / sqrt(select(vec4f(1.0), squares, kept)), kept);
    // A number that is not finite belongs to a direction that is left out, whose factor is 0.
    var m = mat4x4f(
        finite_of(f.x * finite_of(q0) * f),
        finite_of(f.y * finite_of(vec4f(q0.y, q1.xyz)) * f),
        finite_of(f.z * finite_of(vec4f(q0.z, q1.yw, q2.x)) * f),
        finite_of(f.w * finite_of(vec4f(q0.w, q1.z, q2.xy)) * f),
    );
    let most = max(max(largest(m[0]), largest(m[1])), max(largest(m[2]), largest(m[3])));
    if !(most > 0.0) {
        return Solution(vec4f(), dropped);
    }
    let c = -f * (solved(m * (1.0 / most), finite_of(f * finite_of(slopes))) / most);
    // A step that overflows could never be taken back.
    return Solution(select(vec4f(), c, vec4<bool>(all(are_finite(c)))), dropped);
}

// Returns the factor, 0 to 1, for which a parabola of this slope at 0 is least, or 0 if there is none.
fn least(slope: f32, curvature: f32) -> f32 {
    let best = -slope / abs(curvature);
    return select(0.0, clamp(best, 0.0, 1.0), abs(curvature) > 0.0 && is_finite(best));
}

// Returns the point (h, f) at which a start is best: inside of the triangle, or the lowest of the least points of its sides.
fn start() -> vec2f {
    let b = vec2f(WARMEST * sums[3].x, sums[2].w);
    let hh = WARMEST * WARMEST * sums[1].w;
    let hf = WARMEST * sums[1].y;
    let ff = sums[1].x;
    let determinant = hh * ff - hf * hf;
    let inside = vec2f(hf * b.y - ff * b.x, hf * b.x - hh * b.y) / determinant;
    if hh > 0.0 && determinant > 0.0 && inside.y >= 0.0 && inside.y <= inside.x && inside.x <= 1.0 {
        return inside;
    }
    let both = least(b.x + b.y, hh + 2.0 * hf + ff);
    let sides = array<vec2f, 3>(vec2f(least(b.x, hh), 0.0), vec2f(1.0, least(b.y + hf, ff)), vec2f(both));
    var best = vec2f();
    var lowest = 0.0;
    for (var k = 0u; k < 3u; k++) {
        let s = sides[k];
        let value = dot(b, s) + 0.5 * (hh * s.x * s.x + 2.0 * hf * s.x * s.y + ff * s.y * s.y);
        if is_finite(value) && value < lowest {
            best = s;
            lowest = value;
        }
    }
    return best;
}

// Returns the fraction of a step of this slope to which a rise of the energy shortens it.
fn shortened(rise: f32, slope: f32) -> f32 {
    let least = -0.5 * slope / (rise - slope);
    return select(0.1, clamp(least, 0.1, 0.5), is_finite(rise) && is_finite(least));
}

// Decides what all invocations do, and writes the state.
fn decide(b: u32, is_writer: bool) {
    let slopes = vec4f(sums[2].zw, sums[3].xy);
    let last = sums[4];
    let others = sums[5];
    var repulsion = 0.0;
    if REPELS {
        repulsion = repulsions[0];
    }
    let energy = last.z + last.w + others.x + others.y + others.z + repulsion;
    let size = abs(last.z) + abs(last.w) + abs(others.x) + abs(others.y) + abs(others.z) + abs(repulsion);
    // Energy, size, slope; then shortened steps and dropped directions.
    var book = vec3f(energy, size, 0.0);
    var counts = vec2f();
    coefficients = vec4f();
    fraction = 0.0;
    what = 1u;
    if params.stage == 0u {
        let best = start();
        coefficients = vec4f(0.0, best.y, WARMEST * best.x, 0.0);
    } else {
        let row = 5u * (params.before * params.batch + b);
        let old = vec3f(state[row], state[row + 1u], state[row + 2u]);
        counts = vec2f(state[row + 3u], state[row + 4u]);
        let bound = old.x + ENERGY_ERROR * max(size, old.y);
        let is_accepted = is_finite(energy) && is_finite(bound) && energy <= bound;
        if !is_accepted {
            what = 2u;
            counts.x += 1.0;
            fraction = select(shortened(energy - old.x, old.z), 0.0, params.stage == 2u);
            book = vec3f(old.xy, fraction * old.z);
        } else if params.stage == 2u {
            what = 0u;
        } else {
            let solution = minimum();
            coefficients = solution.coefficients;
            counts.y += solution.dropped;
        }
    }
    if what == 1u {
        // A direction without a share may have a slope that is not finite.
        book.z = dot(coefficients, select(slopes, vec4f(), coefficients == vec4f()));
    }
    if is_writer {
        let row = 5u * (params.after * params.batch + b);
        state[row] = book.x;
        state[row + 1u] = book.y;
        state[row + 2u] = book.z;
        state[row + 3u] = counts.x;
        state[row + 4u] = counts.y;
    }
}

// Returns a direction's share of the step. A direction that is left out is not read: 0 times NaN is NaN.
fn share(coefficient: f32, at: u32) -> f32 {
    if coefficient == 0.0 {
        return 0.0;
    }
    return coefficient * directions[at];
}

fn remember(at: u32, step: f32) {
    if REMEMBERS {
        fields[params.last_step + at] = step;
    }
}

@compute @workgroup_size(256)
fn subspace_step(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let b = group.y;
    add_up(b, lane);
    if lane == 0u {
        decide(b, group.x == 0u);
    }
    workgroupBarrier();
    if what == 0u {
        return;
    }
    let c = coefficients;
    for (var e = group.x * 256u + lane; e < params.elements; e += groups.x * 256u) {
        let at = b * params.elements + e;
        let previous = 2u * params.slot + at;
        if what == 1u {
            let step = share(c.x, at) + share(c.y, params.slot + at) + share(c.z, previous)
                + share(c.w, 3u * params.slot + at);
            a[at] += step;
            directions[previous] = step;
            remember(at, step);
        } else {
            let step = directions[previous];
            let kept = fraction * step;
            a[at] -= step - kept;
            directions[previous] = kept;
            remember(at, kept);
        }
    }
}
