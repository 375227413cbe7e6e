
// Bindings of a lifting whose input another kernel has embedded.
//
// x: [S, H, E, Q] quads
// y, rows_or_field: see `block`
@group(0) @binding(5) var<storage, read> x: array<StoredQuad>;
#if texels
@group(0) @binding(6) var y: texture_storage_2d<$texels, write>;
#else
@group(0) @binding(6) var<storage, read_write> y: array<StoredQuad>;
#endif
@group(0) @binding(7) var<storage, read_write> rows_or_field: array<f32>;

fn prepare(_sample: u32, _row: u32, _first_quad: u32, _index: u32) {}

fn channel(sample: u32, e: u32, row: u32, quad: u32) -> vec4f {
    return vec4f(x[((sample * params.rows + row) * params.embedded + e) * params.row_quads + quad]);
}
