
// The scalar head, and the persistent scale it sets, from the kernel's bindings rows_max [s, H, C],
// weight [C] and bias [1].

const TEAMS: u32 = 4;

var<workgroup> maxima: array<array<f32, 64>, TEAMS>;

// Returns bias + sum_c weight[c] max_i rows_max[sample, i, c], the same in every invocation of a workgroup of
// (64, TEAMS). The workgroup takes 64 channels at a time, and each team of 64 invocations a share of the
// rows. Sums have a fixed order. H must be at least TEAMS.
fn scalar_of(sample: u32, rows: u32, channels: u32, index: u32) -> f32 {
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
            sum += weight[channel] * most;
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
    return maxima[0][0] + bias[0];
}

// Returns the persistent scale after a pass whose scalar head is `value` (update rule, paper section 3.3).
fn rescaled(scale: f32, value: f32) -> f32 {
    let half = tanh_exact(vec4f(0.5 * value)).x;
    return scale * exp(2.0 * half - 1.0);
}
