// Input of the network: the normalised fields and the position of each particle (paper section 4).
//
// embedded[s] = [10 tanh(g / s_g / 10), 10 tanh(g_last / s_g / 10), 10 tanh(d_last / s_d / 10), i / (H-1), j / (W-1)]
// with s_g = |g| / sqrt n, s_d = |d_last| / sqrt n. Norms are kept above 1e-30, so that a zero field stays zero.
// grad: [S, H, W]; hidden: [2, S, H, W], last gradient and last step; partial_sums: [S, parts] from `first_sum` on (`norms`);
// embedded: [s, 5, H, Q] quads, zero in the padding, of the s samples from `first` on.
// One invocation: one quad. Workgroups: (Q / 8, H / 8, s).
// Adjoint: none, the input of the network is a constant of the training step.

struct Params {
    rows: u32, // H
    columns: u32, // W
    row_quads: u32, // Q
    parts: u32,
    samples: u32, // S
    first: u32, // sample of S that is the first of embedded
    first_sum: u32, // sum that is the first of partial_sums
    pad: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read> hidden: array<f32>;
@group(0) @binding(3) var<storage, read> partial_sums: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> embedded: array<StoredQuad>;

@compute @workgroup_size(8, 8)
fn features(@builtin(global_invocation_id) id: vec3u) {
    let quad = id.x;
    let row = id.y;
    let sample = params.first + id.z;
    if quad >= params.row_quads || row >= params.rows {
        return;
    }
    var squares = vec2f();
    for (var k = 0u; k < params.parts; k++) {
        squares += partial_sums[params.first_sum + sample * params.parts + k];
    }
    let n = params.rows * params.columns;
    let inverse = sqrt(f32(n)) / max(sqrt(squares), vec2f(1e-30));
    let all = params.samples * n;
    let first = sample * n + row * params.columns + 4u * quad;
    var g = vec4f();
    var last_grad = vec4f();
    var last_step = vec4f();
    var across = vec4f();
    for (var k = 0u; k < 4u; k++) {
        let column = 4u * quad + k;
        if column < params.columns {
            g[k] = grad[first + k];
            last_grad[k] = hidden[first + k];
            last_step[k] = hidden[all + first + k];
            across[k] = f32(column) / f32(params.columns - 1u);
        }
    }
    let inside = vec4u(0u, 1u, 2u, 3u) + 4u * quad < vec4u(params.columns);
    let down = f32(row) / f32(params.rows - 1u);
    let plane = params.rows * params.row_quads;
    let out = id.z * 5u * plane + row * params.row_quads + quad;
    embedded[out] = StoredQuad(squash(g * inverse.x));
    embedded[out + plane] = StoredQuad(squash(last_grad * inverse.x));
    embedded[out + 2u * plane] = StoredQuad(squash(last_step * inverse.y));
    embedded[out + 3u * plane] = StoredQuad(select(vec4f(), vec4f(down), inside));
    embedded[out + 4u * plane] = StoredQuad(across);
}

// 10 tanh(v / 10).
fn squash(v: vec4f) -> vec4f {
    return 10.0 * tanh_exact(0.1 * v);
}
