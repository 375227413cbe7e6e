// Limited-memory BFGS (two-loop recursion).
//
// q = H g and a -= q, with pairs s = a_k - a_(k-1) and y = g_k - g_(k-1), kept if y.s > CURVATURE. The
// initial H is gamma = s.y / y.y of the newest pair, or 1 without pairs. The history is cleared in the first
// iteration of a frame. For any other initial H the recursion is split into two dispatches (PART), between
// which other kernels apply it to q.
//
// With SECANT, the last step s is first corrected to the minimum of the parabola that has the slopes at its
// ends, t = -g_(k-1).s / y.s clamped to 0..LONGEST, if y.s > 0:
//   a += (t - 1) s,  g_k += (t - 1) y,  length = min(1, length clamp(t, SHORTEST, LONGEST))
// and then a -= length q. The length is 1 in the first iteration of a frame.
//
// grad, a: [B, 3 n]
// history: [B, HISTORY, 2, 3 n] = (s, y)
// last: [B, 2, 3 n], last gradient and last step; between the two dispatches, q in place of the step
// pairs: [B, 2 HISTORY + 3], number of pairs, slot of the newest, 1 / y.s of each slot,
//   alpha of the first loop, from the newest pair on, then the length
//
// One workgroup per cloth. Its invocations stride over the elements and add up in a fixed order.
// Workgroups: (B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    particles: u32, // n
    first: u32, // 1 in the first iteration
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read_write> history: array<f32>;
@group(0) @binding(3) var<storage, read_write> last: array<f32>;
@group(0) @binding(4) var<storage, read_write> pairs: array<f32>;
@group(0) @binding(5) var<storage, read_write> a: array<f32>;

const LANES: u32 = 256u;
const MAX_HISTORY: u32 = 32u;
override HISTORY: u32 = 5;
override CURVATURE: f32 = 1e-12;
override SECANT: bool = false;
override LONGEST: f32 = 2.0;
override SHORTEST: f32 = 0.1;
// 0: the whole step; 1: the part before the initial H; 2: the part after it.
override PART: u32 = 0;

var<workgroup> partial: array<vec2f, 256>;
// Of each pair, from the newest on; by an index, private ones would be in memory.
var<workgroup> alpha: array<f32, MAX_HISTORY>;

// Returns the sums over the workgroup, the same in every invocation.
fn total(lane: u32, value: vec2f) -> vec2f {
    workgroupBarrier();
    partial[lane] = value;
    for (var half = LANES / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    workgroupBarrier();
    return partial[0];
}

@compute @workgroup_size(256)
fn lbfgs(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let n = 3u * params.particles;
    let first = group.x * n;
    let book = group.x * (2u * HISTORY + 3u);
    let previous_grad = 2u * first;
    let q = 2u * first + n; // the last step, then the direction
    let ring = 2u * first * HISTORY;
    var count = 0u;
    var newest = HISTORY - 1u;
    var gamma = 1.0;
    var length = 1.0;

    // 1 / y.s of the newest pair.
    var newest_rho = 0.0;
    if params.first == 0u || PART == 2u {
        // Bounded, since they are indices that another dispatch has written.
        count = min(u32(pairs[book]), HISTORY);
        newest = min(u32(pairs[book + 1u]), HISTORY - 1u);
        newest_rho = pairs[book + 2u + newest];
        if SECANT {
            length = pairs[book + 2u + 2u * HISTORY];
        }
    }
    if PART != 2u {
        // The pair of the last step. The first iteration has none.
        var sums = vec2f();
        if params.first == 0u {
            for (var e = lane; e < n; e += LANES) {
                let before = last[previous_grad + e];
                sums += vec2f(grad[first + e] - before, before) * last[q + e];
            }
        }
        sums = total(lane, sums);
        var more = 0.0;
        if SECANT && sums.x > 0.0 {
            let factor = -sums.y / sums.x;
            more = clamp(factor, 0.0, LONGEST) - 1.0;
            length = min(1.0, length * clamp(factor, SHORTEST, LONGEST));
        }
        let keep = params.first == 0u && sums.x > CURVATURE;
        if keep {
            newest = (newest + 1u) % HISTORY;
            count = min(count + 1u, HISTORY);
            // Stored for later dispatches. Within this one, no other invocation reads it.
            newest_rho = 1.0 / sums.x;
            if lane == 0u {
                pairs[book + 2u + newest] = newest_rho;
            }
        }
        let pair = ring + newest * 2u * n;
        for (var e = lane; e < n; e += LANES) {
            var g = grad[first + e];
            let s = last[q + e];
            let y = g - last[previous_grad + e];
            if keep {
                history[pair + e] = s;
                history[pair + n + e] = y;
            }
            if SECANT && params.first == 0u {
                a[first + e] += more * s;
                g += more * y;
            }
            last[previous_grad + e] = g;
            last[q + e] = g;
        }

        for (var k = 0u; k < HISTORY; k++) {
            let slot = (newest + HISTORY - k) % HISTORY;
            let s = ring + slot * 2u * n;
            var sum = vec2f();
            if k < count {
                for (var e = lane; e < n; e += LANES) {
                    let y = history[s + n + e];
                    sum += vec2f(history[s + e] * last[q + e], y * y);
                }
            }
            sum = total(lane, sum);
            if k < count {
                var rho = newest_rho;
                if k > 0u {
                    rho = pairs[book + 2u + slot];
                }
                let share = rho * sum.x;
                if k == 0u {
                    gamma = 1.0 / (rho * sum.y);
                }
                if lane == 0u {
                    alpha[k] = share;
                }
                for (var e = lane; e < n; e += LANES) {
                    last[q + e] -= share * history[s + n + e];
                }
            }
        }
        workgroupBarrier();
        if lane == 0u {
            pairs[book] = f32(count);
            pairs[book + 1u] = f32(newest);
            pairs[book + 2u + 2u * HISTORY] = length;
        }
    }
    if PART == 0u {
        for (var e = lane; e < n; e += LANES) {
            last[q + e] *= gamma;
        }
    } else if PART == 1u {
        if lane < count {
            pairs[book + 2u + HISTORY + lane] = alpha[lane];
        }
        return;
    } else {
        if lane < HISTORY {
            alpha[lane] = pairs[book + 2u + HISTORY + lane];
        }
        workgroupBarrier();
    }
    for (var j = 0u; j < HISTORY; j++) {
        let k = HISTORY - 1u - j; // oldest first
        let slot = (newest + HISTORY - k) % HISTORY;
        let s = ring + slot * 2u * n;
        var sum = vec2f();
        if k < count {
            for (var e = lane; e < n; e += LANES) {
                sum.x += history[s + n + e] * last[q + e];
            }
        }
        sum = total(lane, sum);
        if k < count {
            var rho = newest_rho;
            if k > 0u {
                rho = pairs[book + 2u + slot];
            }
            let beta = rho * sum.x;
            for (var e = lane; e < n; e += LANES) {
                last[q + e] += (alpha[k] - beta) * history[s + e];
            }
        }
    }

    for (var e = lane; e < n; e += LANES) {
        let step = -length * last[q + e];
        last[q + e] = step;
        a[first + e] += step;
    }
}
