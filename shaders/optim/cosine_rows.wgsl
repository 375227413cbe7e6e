// Cosine transform along the rows of forces on the particles of a sheet.
//
// out[f, i, l] = sum_j table[l, j] field_f[i, j]. Of four fields, 0 to 2 are the components of near v, and 3 is the product of the
// forces v with the normal; the two fields (FIELDS = 2) are those with t1 and t2 (`sheet_axes`). All are 0 where no free particle is.
//
// forces: [B, 3, H, W]
// marks: [B, H, W]
// axes: [B, 16, H, W] = t1, t2, the normal, near, and two edges
// table: [W, W], the orthonormal DCT-II, table[l, j] = sqrt((l == 0 ? 1 : 2) / W) cos(pi l (2 j + 1) / 2 W)
// out: [B, FIELDS, H, W]
//
// One invocation per four columns of a row, all fields. Workgroups: (W / 32, H / 8, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> forces: array<f32>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> axes: array<f32>;
@group(0) @binding(4) var<storage, read> table: array<f32>;
@group(0) @binding(5) var<storage, read_write> out: array<f32>;

// Returns an axis of a particle, given where its first component is.
fn axis(at: u32, n: u32) -> vec3f {
    return vec3f(axes[at], axes[at + n], axes[at + 2u * n]);
}

// Stores the fields of a particle, 0 if there is none.
fn load_particle(b: u32, i: u32, j: u32, place: u32) {
    let n = params.rows * params.columns;
    let p = i * params.columns + j;
    var of_particle = vec4f();
    if i < params.rows && j < params.columns && is_free(marks[b * n + p]) {
        let at = b * 3u * n + p;
        let first = b * 16u * n + p;
        let v = vec3f(forces[at], forces[at + n], forces[at + 2u * n]);
        if FIELDS > 2u {
            of_particle = vec4f(axes[first + 9u * n] * v, dot(axis(first + 6u * n, n), v));
        } else {
            of_particle = vec4f(dot(axis(first, n), v), dot(axis(first + 3u * n, n), v), 0.0, 0.0);
        }
    }
    fields[place] = of_particle;
}

@compute @workgroup_size(64)
fn cosine_rows(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let first_row = group.y * 8u;
    let first_column = group.x * 32u;
    for (var first = 0u; first < params.columns; first += DEPTH) {
        workgroupBarrier();
        // Neighbouring invocations read neighbouring elements of particles and table.
        for (var k = lane; k < 8u * DEPTH; k += 64u) {
            let depth = k % DEPTH;
            let other = k / DEPTH;
            let j = first + depth;
            let l = first_column + 4u * other;
            load_particle(b, first_row + other, j, depth * STRIDE + other);
            factors[depth * STRIDE + other] =
                vec4f(cosine(l, j), cosine(l + 1u, j), cosine(l + 2u, j), cosine(l + 3u, j));
        }
        workgroupBarrier();
        add_products(lane / 8u, lane % 8u);
    }
    keep_fields(b, first_row + lane / 8u, first_column + 4u * (lane % 8u));
}
