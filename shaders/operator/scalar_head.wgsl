// Scalar head: scalar[s] = bias + sum_c weight[c] max_i rows_max[s, i, c]; and, with RESCALE, the persistent scale of the sample:
// scale <- scale exp(2 tanh(scalar / 2) - 1) (update rule of the paper's section 3.3).
//
// rows_max: [S, H, C]; weight: [C]; bias: [1]; scalar: [S]; scale: from element `before` on [S], to be written from element `after`
// on. H is at least the number of teams.
// One workgroup: one sample; its invocations take channels in turn, 64 of them at once, and each team of 64 its share of the rows.
// Sums are added up in a fixed order. Workgroups: (S).
// Adjoint: `pool_adj` (x), `head_weight_adj` (weight, bias), `update_adj` (the scale).

struct Params {
    channels: u32, // C
    rows: u32, // H
    before: u32,
    after: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> bias: array<f32>;
@group(0) @binding(3) var<storage, read> rows_max: array<f32>;
@group(0) @binding(4) var<storage, read_write> scalar: array<f32>;
@group(0) @binding(5) var<storage, read_write> scale: array<f32>;

override RESCALE: bool = true;

const TEAMS: u32 = 4;

var<workgroup> held: array<array<f32, 64>, TEAMS>;

@compute @workgroup_size(64, TEAMS)
fn scalar_head(@builtin(local_invocation_id) local: vec3u, @builtin(workgroup_id) group: vec3u) {
    let sample = group.x;
    let lane = local.x;
    let team = local.y;
    var sum = 0.0;
    for (var begin = 0u; begin < params.channels; begin += 64u) {
        let channel = min(begin + lane, params.channels - 1u);
        let first = sample * params.rows * params.channels + channel;
        var most = rows_max[first + team * params.channels];
        for (var i = team + TEAMS; i < params.rows; i += TEAMS) {
            most = max(most, rows_max[first + i * params.channels]);
        }
        held[team][lane] = most;
        workgroupBarrier();
        if team == 0u && begin + lane < params.channels {
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
    if team == 0u && lane == 0u {
        let value = held[0][0] + bias[0];
        scalar[sample] = value;
        if RESCALE {
            let half = tanh_exact(vec4f(0.5 * value)).x;
            scale[params.after + sample] = scale[params.before + sample] * exp(2.0 * half - 1.0);
        }
    }
}
