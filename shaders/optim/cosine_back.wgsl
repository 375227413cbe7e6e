// Inverse cosine transform along the rows of four fields, or two.
//
// out[FIRST + f, i, j] = sum_l table[l, j] z[f, i, l]
//
// table: [W, W], the orthonormal DCT-II
// z: [B, FIELDS, H, W]
// out: [B, 6, H, W], of which the fields from FIRST on are written
//
// One invocation per four columns of a row, all fields. Workgroups: (W / 32, H / 8, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<f32>;
@group(0) @binding(2) var<storage, read> z: array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<f32>;

// The first of the fields in out.
override FIRST: u32 = 0;

// Returns the fields of a mode, 0 if there is none.
fn mode(b: u32, i: u32, l: u32) -> vec4f {
    let n = params.rows * params.columns;
    var of_mode = vec4f();
    if i < params.rows && l < params.columns {
        let at = b * FIELDS * n + i * params.columns + l;
        of_mode.x = z[at];
        of_mode.y = z[at + n];
        if FIELDS > 2u {
            of_mode.z = z[at + 2u * n];
            of_mode.w = z[at + 3u * n];
        }
    }
    return of_mode;
}

// Returns row l of four columns of the table from column j on.
fn quad_along(l: u32, j: u32) -> vec4f {
    return vec4f(cosine(l, j), cosine(l, j + 1u), cosine(l, j + 2u), cosine(l, j + 3u));
}

@compute @workgroup_size(64)
fn cosine_back(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let first_row = group.y * 8u;
    let first_column = group.x * 32u;
    if STAGED {
        for (var first = 0u; first < params.columns; first += DEPTH) {
            workgroupBarrier();
            // Neighbouring invocations read neighbouring elements of z and of the table.
            for (var k = lane; k < 8u * DEPTH; k += 64u) {
                fields[k % DEPTH * STRIDE + k / DEPTH] = mode(b, first_row + k / DEPTH, first + k % DEPTH);
                factors[k / 8u * STRIDE + k % 8u] = quad_along(first + k / 8u, first_column + 4u * (k % 8u));
            }
            workgroupBarrier();
            add_products(lane / 8u, lane % 8u);
        }
    } else {
        // Not plainly a parameter: see `cosine_columns`.
        let columns = params.columns + (lane >> 31u);
        for (var l = 0u; l < columns; l++) {
            add_product(mode(b, first_row + lane / 8u, l), quad_along(l, first_column + 4u * (lane % 8u)));
        }
    }
    keep_fields(6u * b + FIRST, first_row + lane / 8u, first_column + 4u * (lane % 8u));
}
