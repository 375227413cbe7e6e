
// Bindings of a Fourier block.
//
// x: [S, H, C, Q] quads
// y: [S, H, C, Q] quads
// rows_or_field: see `block`
// rows_max: [S, H, C]
#if texels
@group(0) @binding(5) var x: texture_2d<f32>;
@group(0) @binding(6) var y: texture_storage_2d<$texels, write>;
#else
@group(0) @binding(5) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(6) var<storage, read_write> y: array<StoredQuad>;
#endif
@group(0) @binding(7) var<storage, read_write> rows_or_field: array<f32>;
@group(0) @binding(8) var<storage, read_write> rows_max: array<f32>;

const LIFTING: bool = false;

fn prepare(_sample: u32, _row: u32, _first_quad: u32, _index: u32) {}

// Only a lifting has embedded channels.
fn channel(_sample: u32, _e: u32, _row: u32, _quad: u32) -> vec4f {
    return vec4f();
}

// Returns input i at a quad of a row, among the inputs whose weights are the same for all rows.
fn input(sample: u32, i: u32, row: u32, quad: u32) -> vec4f {
    let at = ((sample * params.rows + row) * params.inputs + i) * params.row_quads + quad;
#if texels
    return textureLoad(x, texel(at), 0);
#else
    return vec4f(x[at]);
#endif
}

fn keep_largest(at: u32, largest: f32) {
    rows_max[at] = largest;
}
