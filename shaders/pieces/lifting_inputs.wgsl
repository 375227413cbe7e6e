
// Inputs of the lifting: its hidden units, computed on the fly.
const LIFTING: bool = true;

// Returns hidden unit i at a quad of a row.
fn input(sample: u32, i: u32, row: u32, quad: u32) -> vec4f {
    let quads = params.embedded / 4u + 1u;
    var sum = vec4f();
    for (var q = 0u; q < quads; q++) {
        let w = r[i * quads + q];
        let e = 4u * q;
        sum += w.x * factor(sample, e, row, quad) + w.y * factor(sample, e + 1u, row, quad)
            + w.z * factor(sample, e + 2u, row, quad) + w.w * factor(sample, e + 3u, row, quad);
    }
    return gelu(sum);
}

// Returns channel e of the embedded input; at e = E the 1 that the bias multiplies, beyond it 0.
fn factor(sample: u32, e: u32, row: u32, quad: u32) -> vec4f {
    if e < params.embedded {
        return channel(sample, e, row, quad);
    }
    return vec4f(select(0.0, 1.0, e == params.embedded));
}

// Only blocks pool.
fn keep_largest(_at: u32, _largest: f32) {}
