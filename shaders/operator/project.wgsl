// Last layer of the field head: field[l, j] = bias + sum_c weight[c] x[l, c, j] at position j of line l.
//
// weight: [C]
// bias: [1]
// x: [S, H, C, Q] quads
// field: [S, H, Q] quads
//
// One invocation per quad. Workgroups: (quads / 64 over x and y).
// Adjoint: `project_adj` (x), `head_weight_adj` (weight, bias).

struct Params {
    channels: u32, // C
    quads: u32, // S H Q
    row_quads: u32, // Q
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<f32>;
@group(0) @binding(2) var<storage, read> bias: array<f32>;
@group(0) @binding(3) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(4) var<storage, read_write> field: array<vec4f>;

@compute @workgroup_size(64)
fn project(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= params.quads {
        return;
    }
    let first = p / params.row_quads * params.channels * params.row_quads + p % params.row_quads;
    var sum = vec4f(bias[0]);
    for (var c = 0u; c < params.channels; c++) {
        sum += weight[c] * vec4f(x[first + c * params.row_quads]);
    }
    field[p] = sum;
}
