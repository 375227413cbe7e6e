
// What is lifted, embedded on the way, of the quads of a workgroup. fields, partial_sums: see `features`.
@group(0) @binding(5) var<storage, read> fields: array<f32>;
@group(0) @binding(6) var<storage, read> partial_sums: array<f32>;
@group(0) @binding(7) var<storage, read_write> y: array<StoredQuad>;
@group(0) @binding(8) var<storage, read_write> made: array<f32>;

// Quads of E channels of WIDE quads, which the workgroup's memory has behind those that are staged, AHEAD of them.
override EMBEDDED: u32 = 1;
override AHEAD: u32 = 0;

fn prepare(sample: u32, row: u32, first_quad: u32, index: u32) {
    let at = FieldsOf(
        params.first + sample,
        params.all_samples,
        params.rows,
        params.width,
        params.hidden,
        params.parts,
        params.first_sum,
    );
    let inverse = inverse_sizes(at, index, WIDE * HIGH * DEEP);
    for (var k = index; k < EMBEDDED; k += WIDE * HIGH * DEEP) {
        memory[AHEAD + k] = feature(at, inverse, k / WIDE, row, first_quad + k % WIDE);
    }
}

// A workgroup's quads begin at a multiple of WIDE.
fn channel(_sample: u32, e: u32, _row: u32, quad: u32) -> vec4f {
    return memory[AHEAD + e * WIDE + quad % WIDE];
}
