// Last layer of the field head: field[s, p] = bias + sum_c weight[c] x[s, c, p].
//
// x: [S, C, H, Q] quads; weight: [C]; bias: [1]; field: [S, H, Q] quads.
// One invocation: one quad. Workgroups: (quads / 64, S).
// Adjoint: `project_adj` (x), `head_weight_adj` (weight, bias).

struct Params {
    channels: u32, // C
    quads: u32, // H Q
    pad0: u32,
    pad1: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> bias: array<f32>;
@group(0) @binding(3) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(4) var<storage, read_write> field: array<vec4f>;

@compute @workgroup_size(64)
fn project(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u) {
    let p = id.x;
    if p >= params.quads {
        return;
    }
    let sample = group.y;
    let first = sample * params.channels * params.quads + p;
    var sum = vec4f(bias[0]);
    for (var c = 0u; c < params.channels; c++) {
        sum += weight[c] * vec4f(x[first + c * params.quads]);
    }
    field[sample * params.quads + p] = sum;
}
