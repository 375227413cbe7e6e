
// The scalar head, of what a kernel binds as rows_max [s, H, C], weight [C] and bias [1], and the step that it sets.

const TEAMS: u32 = 4;

var<workgroup> held: array<array<f32, 64>, TEAMS>;

// bias + sum_c weight[c] max_i rows_max[sample, i, c], the same in every invocation of a workgroup of 64 x TEAMS: they take channels
// in turn, 64 of them at once, and each team of 64 its share of the rows. Sums are added up in a fixed order. H is at least TEAMS.
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
        held[team][lane] = most;
        workgroupBarrier();
        if team == 0u && begin + lane < channels {
            for (var other = 1u; other < TEAMS; other++) {
                most = max(most, held[other][lane]);
            }
            sum += weight[channel] * most;
        }
        workgroupBarrier();
    }
    if team == 0u {
        held[0][lane] = sum;
    }
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if team == 0u && lane < half {
            held[0][lane] += held[0][lane + half];
        }
    }
    workgroupBarrier();
    return held[0][0] + bias[0];
}

// The persistent scale after a pass whose scalar head gives `value` (update rule of the paper's section 3.3).
fn rescaled(scale: f32, value: f32) -> f32 {
    let half = tanh_exact(vec4f(0.5 * value)).x;
    return scale * exp(2.0 * half - 1.0);
}
