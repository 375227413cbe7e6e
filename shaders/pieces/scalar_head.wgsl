
// The scalar head, and the persistent scale it sets, from the kernel's bindings rows_max [s, H, C],
// head (weight [C], and the bias at another element) and, with OF_STEP, sums.

const TEAMS: u32 = 4;

// Whether a pass begins with the size of the last step, as where steps are directions among others, instead of the scale before it.
override OF_STEP: bool = false;

// Smallest size of a component's step, as a share of the largest.
const LEAST_SHARE: f32 = 0.01;

var<workgroup> maxima: array<array<f32, 64>, TEAMS>;
// Of the three components of a cloth.
var<workgroup> squares: array<f32, 192>;

// Returns bias + sum_c weight[c] max_i rows_max[sample, i, c], the same in every invocation of a workgroup of
// (64, TEAMS). The workgroup takes 64 channels at a time, and each team of 64 invocations a share of the
// rows. Sums have a fixed order. H must be at least TEAMS.
fn scalar_of(sample: u32, rows: u32, channels: u32, bias: u32, index: u32) -> f32 {
    let lane = index % 64u;
    let team = index / 64u;
    var sum = 0.0;
    for (var begin = 0u; begin < channels; begin += 64u) {
        let channel = min(begin + lane, channels - 1u);
        let first = sample * rows * channels + channel;
        var most = rows_max[first + team * channels];
        for (var i = team + TEAMS; i < rows; i += TEAMS) {
            most = max(most, rows_max[first + i * channels]);
        }
        maxima[team][lane] = most;
        workgroupBarrier();
        if team == 0u && begin + lane < channels {
            for (var other = 1u; other < TEAMS; other++) {
                most = max(most, maxima[other][lane]);
            }
            sum += head[channel] * most;
        }
        workgroupBarrier();
    }
    if team == 0u {
        maxima[0][lane] = sum;
    }
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if team == 0u && lane < half {
            maxima[0][lane] += maxima[0][lane + half];
        }
    }
    workgroupBarrier();
    return maxima[0][0] + head[bias];
}

// Returns the persistent scale after a pass whose scalar head is `value` (update rule, paper section 3.3).
fn rescaled(scale: f32, value: f32) -> f32 {
    let half = tanh_exact(vec4f(0.5 * value)).x;
    return scale * exp(2.0 * half - 1.0);
}

// Where the size of the last step comes from.
struct LastStep {
    particles: u32, // n
    parts: u32,
    first_sum: u32,
}

// Returns the root mean square of the last step of a sample among all, at least LEAST_SHARE of the largest of its cloth's three, from the
// partial sums [S, parts, 2] of squares of gradient and last step from sum `first_sum` on; `otherwise` for a cloth without a step. All invocations
// of a workgroup of (64, TEAMS) must call it.
fn size_of_step(sample: u32, at: LastStep, otherwise: f32, index: u32) -> f32 {
    if index < 192u {
        let first = at.first_sum + (sample / 3u * 3u + index / 64u) * at.parts;
        var sum = 0.0;
        for (var part = index % 64u; part < at.parts; part += 64u) {
            sum += sums[first + part].y;
        }
        squares[index] = sum;
    }
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if index < 192u && index % 64u < half {
            squares[index] += squares[index + half];
        }
    }
    workgroupBarrier();
    let largest = max(squares[0], max(squares[64], squares[128]));
    if largest > 0.0 && is_finite(largest) {
        let own = sqrt(squares[64u * (sample % 3u)]);
        return max(own, LEAST_SHARE * sqrt(largest)) / sqrt(f32(at.particles));
    }
    return otherwise;
}
