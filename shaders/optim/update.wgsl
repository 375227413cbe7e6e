// The learned step: step = scale tanh(field); a += step; hidden <- (grad, step).
//
// With PROPOSES, the step is a direction among others: a <- step, 0 where no free particle is.
//
// With HEAD, each workgroup first computes the new scale of its sample from the row maxima, as `scalar_head`
// does, and the first workgroup of the sample stores it. OF_STEP is for both.
//
// field: [parts, s, H, Q] quads, parts to be summed, of the s samples from `first` on
// rows_max: [s, H, C]
// head: weight [C], and the bias at element `bias`
// sums: [S, parts, 2] from sum `first_sum` on, partial sums of the squares of the gradient and the last step
// marks: [B, H, W]; only with PROPOSES
// scale: [s] from element `after` on; with HEAD, computed from the [s] from element `before` on
// fields: grad [S, H, W] = [B, 3, H, W], then from element `hidden` on last gradient and last step, of the
//   same shape
// a: [S, H, W]
//
// One invocation per component of one or more particles. Workgroups: (at most n / 256, s).
// Adjoint: `update_adj`.

struct Params {
    rows: u32, // H
    columns: u32, // W
    row_quads: u32, // Q
    samples: u32, // S
    parts: u32,
    first: u32, // first of the s samples among the S
    in_field: u32, // s
    hidden: u32,
    channels: u32, // C
    bias: u32,
    before: u32,
    after: u32,
    parts_of_sums: u32,
    first_sum: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read> rows_max: array<f32>;
@group(0) @binding(3) var<storage, read> head: array<f32>;
@group(0) @binding(4) var<storage, read> sums: array<vec2f>;
@group(0) @binding(5) var<storage, read> marks: array<vec2u>;
@group(0) @binding(6) var<storage, read_write> scale: array<f32>;
@group(0) @binding(7) var<storage, read_write> fields: array<f32>;
@group(0) @binding(8) var<storage, read_write> a: array<f32>;

override HEAD: bool = false;
override PROPOSES: bool = false;

@compute @workgroup_size(64, TEAMS)
fn update(
    @builtin(local_invocation_index) index: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let sample = params.first + group.y;
    var step_scale = 0.0;
    if HEAD {
        let value = scalar_of(group.y, params.rows, params.channels, params.bias, index);
        var before = scale[params.before + group.y];
        if OF_STEP {
            before = size_of_step(sample, LastStep(n, params.parts_of_sums, params.first_sum), before, index);
        }
        step_scale = rescaled(before, value);
        if group.x == 0u && index == 0u {
            scale[params.after + group.y] = step_scale;
        }
    } else {
        step_scale = scale[params.after + group.y];
    }
    for (var p = group.x * 64u * TEAMS + index; p < n; p += groups.x * 64u * TEAMS) {
        let at = sample * n + p;
        let row = group.y * params.rows + p / params.columns;
        let padded = row * 4u * params.row_quads + p % params.columns;
        var value = field[padded];
        for (var part = 1u; part < params.parts; part++) {
            value += field[padded + part * params.in_field * params.rows * 4u * params.row_quads];
        }
        let step = step_scale * tanh_exact(vec4f(value)).x;
        fields[params.hidden + at] = fields[at];
        fields[params.hidden + params.samples * n + at] = step;
        if PROPOSES {
            a[at] = select(0.0, step, is_free(marks[sample / 3u * n + p]));
        } else {
            a[at] += step;
        }
    }
}
