// The learned step: step = scale tanh(field); a += step; hidden <- (grad, step).
//
// Then the shift of the trial: x(a) - x = base + a, or base alone at a handle, whose way is prescribed.
// field: [parts, s, H, Q] quads, to be added up, of the s samples from `first` on; scale: [S] from `first_scale` on;
// grad, base, a, shift: [S, H, W] = [B, 3, H, W]; slots: [B, H, W]; hidden: [2, S, H, W], last gradient and last step.
// One invocation: one particle's component. Workgroups: (n / 64 along x, then y, and s).
// Adjoint: `update_adj`.

struct Params {
    rows: u32, // H
    columns: u32, // W
    row_quads: u32, // Q
    samples: u32, // S
    parts: u32,
    first: u32, // sample of S that is the first of field
    in_field: u32, // s
    first_scale: u32, // element that is the first of scale
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> field: array<f32>;
@group(0) @binding(2) var<storage, read> scale: array<f32>;
@group(0) @binding(3) var<storage, read> grad: array<f32>;
@group(0) @binding(4) var<storage, read> base: array<f32>;
@group(0) @binding(5) var<storage, read> slots: array<u32>;
@group(0) @binding(6) var<storage, read_write> hidden: array<f32>;
@group(0) @binding(7) var<storage, read_write> a: array<f32>;
@group(0) @binding(8) var<storage, read_write> shift: array<f32>;

@compute @workgroup_size(64)
fn update(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let sample = params.first + group.z;
    if p >= n {
        return;
    }
    let at = sample * n + p;
    let padded = (group.z * params.rows + p / params.columns) * 4u * params.row_quads + p % params.columns;
    var value = field[padded];
    for (var part = 1u; part < params.parts; part++) {
        value += field[padded + part * params.in_field * params.rows * 4u * params.row_quads];
    }
    let step = scale[params.first_scale + sample] * tanh_exact(vec4f(value)).x;
    hidden[at] = grad[at];
    hidden[params.samples * n + at] = step;
    let next = a[at] + step;
    a[at] = next;
    shift[at] = base[at] + select(next, 0.0, slots[sample / 3u * n + p] != 0u);
}
