// Copies the cloths of a batch out of their pool. A cloth that is reset is the rotated sheet at rest, with
// everything else fresh.
//
// The sheet at rest has particle (i, j) at (j, i - (H-1)/2, 0).
//
// drawn: [B]
// pool: [P, 5, 3, n] = x, v, a, last gradient, last step
// pool_scale: [P, 3]
// x, v, a: [B, 3, n]
// hidden: [2, 3 B, n], last gradient and last step
// scale: [3 B]
//
// One invocation per component of a particle. Workgroups: (n / 64, 3 B).
// Adjoint: none, the state is a constant of the training step.

struct Params {
    rows: u32, // H
    columns: u32, // W
    samples: u32, // 3 B
    scale: f32, // of a fresh hidden state
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> drawn: array<Drawn>;
@group(0) @binding(2) var<storage, read> pool: array<f32>;
@group(0) @binding(3) var<storage, read> pool_scale: array<f32>;
@group(0) @binding(4) var<storage, read_write> x: array<f32>;
@group(0) @binding(5) var<storage, read_write> v: array<f32>;
@group(0) @binding(6) var<storage, read_write> a: array<f32>;
@group(0) @binding(7) var<storage, read_write> hidden: array<f32>;
@group(0) @binding(8) var<storage, read_write> scale: array<f32>;

@compute @workgroup_size(64)
fn draw(@builtin(global_invocation_id) id: vec3u) {
    let n = params.rows * params.columns;
    let p = id.x;
    if p >= n {
        return;
    }
    let sample = id.y;
    let component = sample % 3u;
    let at = sample * n + p;
    // A slot that the pool does not have must not lead out of it.
    let slot = min(drawn[sample / 3u].slot, arrayLength(&pool) / (15u * n) - 1u);
    let at_pool = (slot * 15u + component) * n + p;
    var state = array(pool[at_pool], pool[at_pool + 3u * n], pool[at_pool + 6u * n]);
    var last = array(pool[at_pool + 9u * n], pool[at_pool + 12u * n]);
    var next = pool_scale[3u * slot + component];
    if drawn[sample / 3u].begin != 0u {
        let row = drawn[sample / 3u].rotation[component];
        let rest = vec2f(f32(p % params.columns), f32(p / params.columns) - 0.5 * f32(params.rows - 1u));
        state = array(dot(row.xy, rest), 0.0, 0.0);
        last = array(0.0, 0.0);
        next = params.scale;
    }
    x[at] = state[0];
    v[at] = state[1];
    a[at] = state[2];
    hidden[at] = last[0];
    hidden[params.samples * n + at] = last[1];
    if p == 0u {
        scale[sample] = next;
    }
}
