// Cosine transform along the rows of the gradient g, and of g in the axes of the sheet.
//
// z[f, i, l] = sum_j table[l, j] field_f[i, j]; fields 0 to 2 are the components of near g, fields 3 to 5 the
// products of g with t1, t2 and the normal (`sheet_axes`). Both are 0 where no free particle is.
//
// grad: [B, 3, H, W]
// marks: [B, H, W]
// axes: [B, 10, H, W] = t1, t2, the normal, near
// table: [W, W], the orthonormal DCT-II, table[l, j] = sqrt((l == 0 ? 1 : 2) / W) cos(pi l (2 j + 1) / 2 W)
// z: [B, 6, H, W]
//
// One invocation per four columns of a row, all six fields. Workgroups: (W / 32, H / 8, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grad: array<f32>;
@group(0) @binding(2) var<storage, read> marks: array<vec2u>;
@group(0) @binding(3) var<storage, read> axes: array<f32>;
@group(0) @binding(4) var<storage, read> table: array<f32>;
@group(0) @binding(5) var<storage, read_write> z: array<f32>;

// Stores the fields of a particle, 0 if there is none.
fn load_particle(b: u32, i: u32, j: u32, place: u32) {
    let n = params.rows * params.columns;
    let p = i * params.columns + j;
    var world = vec3f();
    var own = vec3f();
    if i < params.rows && j < params.columns && is_free(marks[b * n + p]) {
        let at = b * 3u * n + p;
        let axis = b * 10u * n + p;
        let t1 = vec3f(axes[axis], axes[axis + n], axes[axis + 2u * n]);
        let t2 = vec3f(axes[axis + 3u * n], axes[axis + 4u * n], axes[axis + 5u * n]);
        let normal = vec3f(axes[axis + 6u * n], axes[axis + 7u * n], axes[axis + 8u * n]);
        let g = vec3f(grad[at], grad[at + n], grad[at + 2u * n]);
        world = axes[axis + 9u * n] * g;
        own = vec3f(dot(t1, g), dot(t2, g), dot(normal, g));
    }
    firsts[place] = world;
    lasts[place] = own;
}

// Returns element (l, j) of the table, 0 outside of it.
fn cosine(l: u32, j: u32) -> f32 {
    if l < params.columns && j < params.columns {
        return table[l * params.columns + j];
    }
    return 0.0;
}

// Writes the columns of a quad that exist.
fn keep(at: u32, v: vec4f, columns: u32) {
    if columns > 0u { z[at] = v.x; }
    if columns > 1u { z[at + 1u] = v.y; }
    if columns > 2u { z[at + 2u] = v.z; }
    if columns > 3u { z[at + 3u] = v.w; }
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
    let i = first_row + lane / 8u;
    let l = first_column + 4u * (lane % 8u);
    if i < params.rows && l < params.columns {
        let n = params.rows * params.columns;
        let at = b * 6u * n + i * params.columns + l;
        let columns = params.columns - l;
        keep(at, sum0, columns);
        keep(at + n, sum1, columns);
        keep(at + 2u * n, sum2, columns);
        keep(at + 3u * n, sum3, columns);
        keep(at + 4u * n, sum4, columns);
        keep(at + 5u * n, sum5, columns);
    }
}
