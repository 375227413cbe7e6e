// Copies the cloths of a batch back into their pool, the reverse of `draw`.
//
// drawn: [B]
// x, v, a: [B, 3, n]
// hidden: [2, 3 B, n], last gradient and last step
// scale: [3 B]
// pool: [P, 5, 3, n] = x, v, a, last gradient, last step
// pool_scale: [P, 3]
//
// One invocation per component of a particle. Workgroups: (n / 64, 3 B).
// Adjoint: none, the state is a constant of the training step.

struct Params {
    particles: u32, // n
    samples: u32, // 3 B
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> drawn: array<Drawn>;
@group(0) @binding(2) var<storage, read> x: array<f32>;
@group(0) @binding(3) var<storage, read> v: array<f32>;
@group(0) @binding(4) var<storage, read> a: array<f32>;
@group(0) @binding(5) var<storage, read> hidden: array<f32>;
@group(0) @binding(6) var<storage, read> scale: array<f32>;
@group(0) @binding(7) var<storage, read_write> pool: array<f32>;
@group(0) @binding(8) var<storage, read_write> pool_scale: array<f32>;

@compute @workgroup_size(64)
fn store(@builtin(global_invocation_id) id: vec3u) {
    let n = params.particles;
    let p = id.x;
    if p >= n {
        return;
    }
    let sample = id.y;
    let at = sample * n + p;
    // A slot that the pool does not have must not lead out of it.
    let slot = min(drawn[sample / 3u].slot, arrayLength(&pool) / (15u * n) - 1u);
    let to = (slot * 15u + sample % 3u) * n + p;
    pool[to] = x[at];
    pool[to + 3u * n] = v[at];
    pool[to + 6u * n] = a[at];
    pool[to + 9u * n] = hidden[at];
    pool[to + 12u * n] = hidden[params.samples * n + at];
    if p == 0u {
        pool_scale[3u * slot + sample % 3u] = scale[sample];
    }
}
