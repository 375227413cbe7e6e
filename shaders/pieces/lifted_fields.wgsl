
// Bindings of a lifting that embeds its own input, for the quads of its workgroup.
//
// fields, partial_sums: see `features`
// y, rows_or_field: see `block`
@group(0) @binding(5) var<storage, read> fields: array<f32>;
@group(0) @binding(6) var<storage, read> partial_sums: array<f32>;
#if texels
@group(0) @binding(7) var y: texture_storage_2d<$texels, write>;
#else
@group(0) @binding(7) var<storage, read_write> y: array<StoredQuad>;
#endif
@group(0) @binding(8) var<storage, read_write> rows_or_field: array<f32>;

// Embedded quads in workgroup memory, E channels of SPAN * WIDE quads. They follow the STAGED_QUADS staged
// ones.
override EMBEDDED: u32 = 1;
override STAGED_QUADS: u32 = 0;

var<private> inverse: vec2f;

fn prepare(sample: u32, row: u32, first_quad: u32, index: u32) {
    inverse = inverse_rms(fields_of(sample), index, WIDE * DEEP);
    if STAGED {
        let quads = SPAN * WIDE;
        for (var k = index; k < EMBEDDED; k += WIDE * DEEP) {
            memory[STAGED_QUADS + k] =
                feature(fields_of(sample), inverse, k / quads, row, first_quad + k % quads);
        }
    }
}

// Returns channel e at a quad of a row. A workgroup's first quad is a multiple of SPAN * WIDE.
fn channel(sample: u32, e: u32, row: u32, quad: u32) -> vec4f {
    if STAGED {
        return memory[STAGED_QUADS + e * SPAN * WIDE + quad % (SPAN * WIDE)];
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
