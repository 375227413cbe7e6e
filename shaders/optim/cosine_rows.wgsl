// Cosine transform along the rows of forces on the particles of a sheet, in space and across it.
//
// z_f[i, l] = sum_j table[l, j] field_f[i, j]. Fields 0 to 2 are the components of near v, and 3 is the product of the
// forces v with the normal. All are 0 where no free particle is.
//
// forces: [B, 3, H, W]
// marks: [B, H, W]
// axes: [B, 16, H, W] = t1, t2, the normal, near, and two edges
// table: [W, W], the orthonormal DCT-II, table[l, j] = sqrt((l == 0 ? 1 : 2) / W) cos(pi l (2 j + 1) / 2 W)
// z: [B, 6, H, W], of which fields 0 to 3 are written
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
@group(0) @binding(5) var<storage, read_write> z: array<f32>;

const FIELDS: u32 = 4u;

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

@compute @workgroup_size(LANES)
fn cosine_rows(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let first_row = group.y * 8u;
    let first_column = group.x * 32u;
    let i = first_row + row_of(lane);
    let column = first_column + 4u * quad_of(lane);
    if STAGED {
        for (var first = 0u; first < params.columns; first += DEPTH) {
            workgroupBarrier();
            // Neighbouring invocations read neighbouring elements of particles.
            for (var k = lane; k < ROWS * DEPTH; k += LANES) {
                fields[k % DEPTH * STRIDE + k / DEPTH] = particle(b, first_row + k / DEPTH, first + k % DEPTH);
            }
            load_factors(lane, first, first_column);
            workgroupBarrier();
            add_products(lane);
        }
    } else {
        // Not plainly a parameter: see `cosine_columns`.
        let columns = params.columns + (lane >> 31u);
        for (var j = 0u; j < columns; j++) {
            add_product(particle(b, i, j), quad_of_cosines(column, j));
        }
    }
    if i < params.rows && column < params.columns {
        let n = params.rows * params.columns;
        let at = 6u * b * n + i * params.columns + column;
        let columns = params.columns - column;
        keep_modes(at, sum0, columns);
        keep_modes(at + n, sum1, columns);
        keep_modes(at + 2u * n, sum2, columns);
        keep_modes(at + 3u * n, sum3, columns);
    }
}
