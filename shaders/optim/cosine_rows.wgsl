// Cosine transform along the rows of forces on the particles of a sheet, in space and across it.
//
// out[f, i, l] = sum_j table[l, j] field_f[i, j]. Fields 0 to 2 are the components of near v, and 3 is the product of the
// forces v with the normal. All are 0 where no free particle is.
//
// forces: [B, 3, H, W]
// marks: [B, H, W]
// axes: [B, 16, H, W] = t1, t2, the normal, near, and two edges
// table: [W, W], the orthonormal DCT-II, table[l, j] = sqrt((l == 0 ? 1 : 2) / W) cos(pi l (2 j + 1) / 2 W)
// out: [B, 4, H, W]
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

// Returns the fields of a particle, 0 if there is none that is free. All is loaded before that is known, so that loads don't wait for each
// other.
fn particle(b: u32, i: u32, j: u32) -> vec4f {
    let n = params.rows * params.columns;
    if i >= params.rows || j >= params.columns {
        return vec4f();
    }
    let p = i * params.columns + j;
    let at = b * 3u * n + p;
    let normal = (16u * b + 6u) * n + p;
    let v = vec3f(forces[at], forces[at + n], forces[at + 2u * n]);
    let across = dot(vec3f(axes[normal], axes[normal + n], axes[normal + 2u * n]), v);
    let near = axes[normal + 3u * n];
    return select(vec4f(), vec4f(near * v, across), is_free(marks[b * n + p]));
}

@compute @workgroup_size(64)
fn cosine_rows(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let first_row = group.y * 8u;
    let first_column = group.x * 32u;
    if STAGED {
        for (var first = 0u; first < params.columns; first += DEPTH) {
            workgroupBarrier();
            // Neighbouring invocations read neighbouring elements of particles and table.
            for (var k = lane; k < 8u * DEPTH; k += 64u) {
                let place = k % DEPTH * STRIDE + k / DEPTH;
                fields[place] = particle(b, first_row + k / DEPTH, first + k % DEPTH);
                factors[place] = quad_of_cosines(first_column + 4u * (k / DEPTH), first + k % DEPTH);
            }
            workgroupBarrier();
            add_products(lane / 8u, lane % 8u);
        }
    } else {
        // Not plainly a parameter: see `cosine_columns`.
        let columns = params.columns + (lane >> 31u);
        for (var j = 0u; j < columns; j++) {
            let factor = quad_of_cosines(first_column + 4u * (lane % 8u), j);
            add_product(particle(b, first_row + lane / 8u, j), factor);
        }
    }
    keep_fields(4u * b, first_row + lane / 8u, first_column + 4u * (lane % 8u));
}
