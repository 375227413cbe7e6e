// Gradient of the weight of `spectral`: gradient[m, i, o] += sum_s conj(x[s, m, i]) adj[s, m, o], complex.
//
// x: [S, M, I] complex
// adj: [S, M, O] complex
// gradient: [M, I / 2, O, 2] complex, in the order of `spectral`'s weight
//
// One invocation per output channel of a mode and tile of inputs. The tile is an even number of inputs that
// divides I.
// Workgroups: (O / 64, M, I / tile).
// Adjoint: none, it is one.

struct Params {
    inputs: u32, // I
    outputs: u32, // O
    modes: u32, // M
    samples: u32, // S
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<vec2f>;
@group(0) @binding(2) var<storage, read> adj: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> gradient: array<vec2f>;

@compute @workgroup_size(64)
fn spectral_weight_adj(@builtin(global_invocation_id) id: vec3u, @builtin(workgroup_id) group: vec3u$lane) {
    // Invocations beyond the last channel still take part in subgroup broadcasts.
    let channel = min(id.x, params.outputs - 1u);
    let mode = group.y;
    let first = group.z * $n;
    var sum$c = vec2f();
    for (var s = 0u; s < params.samples; s++) {
        let y = adj[(s * params.modes + mode) * params.outputs + channel];
        let first_x = (s * params.modes + mode) * params.inputs + first;
        let x$c = $same(x[first_x + $c]);
        sum$c += vec2f(x$c.x * y.x + x$c.y * y.y, x$c.x * y.y - x$c.y * y.x);
    }
    if id.x >= params.outputs {
        return;
    }
    let out = (mode * params.inputs + first) * params.outputs + 2u * channel;
    gradient[out + $c / 2u * 2u * params.outputs + $c % 2u] += sum$c;
}
