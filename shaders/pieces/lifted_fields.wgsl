
// What is lifted, embedded on the way, of the quads of a workgroup. fields, partial_sums: see `features`.
@group(0) @binding(5) var<storage, read> fields: array<f32>;
@group(0) @binding(6) var<storage, read> partial_sums: array<f32>;
@group(0) @binding(7) var<storage, read_write> y: array<StoredQuad>;
@group(0) @binding(8) var<storage, read_write> made: array<f32>;

// Quads of E channels of SPAN * WIDE quads, which the workgroup's memory has behind those that are staged, AHEAD of them.
override EMBEDDED: u32 = 1;
override AHEAD: u32 = 0;

var<private> inverse: vec2f;

fn prepare(sample: u32, row: u32, first_quad: u32, index: u32) {
    inverse = inverse_sizes(fields_of(sample), index, WIDE * DEEP);
    if STAGED {
        let quads = SPAN * WIDE;
        for (var k = index; k < EMBEDDED; k += WIDE * DEEP) {
            memory[AHEAD + k] = feature(fields_of(sample), inverse, k / quads, row, first_quad + k % quads);
        }
    }
}

// A workgroup's quads begin at a multiple of SPAN * WIDE.
fn channel(sample: u32, e: u32, row: u32, quad: u32) -> vec4f {
    if STAGED {
        return memory[AHEAD + e * SPAN * WIDE + quad % (SPAN * WIDE)];
    }
    return feature(fields_of(sample), inverse, e, row, quad);
}

fn fields_of(sample: u32) -> FieldsOf {
    return FieldsOf(
        params.first + sample,
        params.all_samples,
        params.rows,
        params.width,
        params.hidden,
        params.parts,
        params.first_sum,
    );
}
