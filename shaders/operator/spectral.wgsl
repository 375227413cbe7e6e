// Channel product of each kept mode: y[s, m, o] = sum_i x[s, m, i] weight[m, i, o], complex.
//
// x: [S, M, I] complex; weight: [M, I, O] complex; y: [S, M, O] complex. The tile is the number of samples that share
// one reading of the weights; S is a multiple of it.
// One invocation: one output channel of one mode, for the samples of a tile. Workgroups: (O / 64, M, S / tile).
// Adjoint: itself with the `spectral_transpose`d weight (x), `spectral_weight_adj` (weight).

struct Params {
    inputs: u32, // I
    outputs: u32, // O
    modes: u32, // M
    pad: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> weight: array<vec2f>;
@group(0) @binding(2) var<storage, read> x: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> y: array<vec2f>;

@compute @workgroup_size(64)
fn spectral(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    // Invocations beyond the last channel take part in what a subgroup shares.
    let channel = min(id.x, params.outputs - 1u);
    let mode = group.y;
    let sample = group.z * $n;
    let stride = params.modes * params.inputs;
    let first = sample * stride + mode * params.inputs;
    var y$c = vec2f();
    for (var i = 0u; i < params.inputs; i++) {
        let w = weight[(mode * params.inputs + i) * params.outputs + channel];
        let x$c = $same(x, first + $c * stride + i);
        y$c += vec2f(x$c.x * w.x - x$c.y * w.y, x$c.x * w.y + x$c.y * w.x);
    }
    if id.x >= params.outputs {
        return;
    }
    let out = (sample * params.modes + mode) * params.outputs + channel;
    y[out + $c * params.modes * params.outputs] = y$c;
}
