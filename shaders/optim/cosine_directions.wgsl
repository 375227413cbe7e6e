// Inverse cosine transform along the rows, which ends the spectral and the co-rotated direction.
//
// With y_f[i, j] = sum_l table[l, j] z[f, i, l], at free particles
//   direction 0 = -near (y_0, y_1, y_2)
//   direction 1 = -(y_3 t1 + y_4 t2 + y_5 normal)
// and both are 0 elsewhere.
//
// marks: [B, H, W]
// axes: [B, 10, H, W] = t1, t2, the normal, near (`sheet_axes`)
// table: [W, W], the orthonormal DCT-II
// z: [B, 6, H, W]
// directions: [K, slot], of which slots 0 and 1 [B, 3, H, W] are written
//
// One invocation per four columns of a row, all six fields. Workgroups: (W / 32, H / 8, B).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    slot: u32, // elements from a direction to the next, at least 3 B H W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read> axes: array<f32>;
@group(0) @binding(3) var<storage, read> table: array<f32>;
@group(0) @binding(4) var<storage, read> z: array<f32>;
@group(0) @binding(5) var<storage, read_write> directions: array<f32>;

// Stores the fields of a mode, 0 if there is none.
fn load_mode(b: u32, i: u32, l: u32, place: u32) {
    let n = params.rows * params.columns;
    var first = vec3f();
    var last = vec3f();
    if i < params.rows && l < params.columns {
        let at = b * 6u * n + i * params.columns + l;
        first = vec3f(z[at], z[at + n], z[at + 2u * n]);
        last = vec3f(z[at + 3u * n], z[at + 4u * n], z[at + 5u * n]);
    }
    firsts[place] = first;
    lasts[place] = last;
}

// Returns element (l, j) of the table, 0 outside of it.
fn cosine(l: u32, j: u32) -> f32 {
    if l < params.columns && j < params.columns {
        return table[l * params.columns + j];
    }
    return 0.0;
}

// Writes both directions at particle (i, j), if it exists.
fn keep(b: u32, i: u32, j: u32, world: vec3f, own: vec3f) {
    if i >= params.rows || j >= params.columns {
        return;
    }
    let n = params.rows * params.columns;
    let p = i * params.columns + j;
    let free = is_free(marks[b * n + p]);
    let axis = b * 10u * n + p;
    let t1 = vec3f(axes[axis], axes[axis + n], axes[axis + 2u * n]);
    let t2 = vec3f(axes[axis + 3u * n], axes[axis + 4u * n], axes[axis + 5u * n]);
    let normal = vec3f(axes[axis + 6u * n], axes[axis + 7u * n], axes[axis + 8u * n]);
    let spectral = select(vec3f(), -axes[axis + 9u * n] * world, free);
    let rotated = select(vec3f(), -(own.x * t1 + own.y * t2 + own.z * normal), free);
    let at = b * 3u * n + p;
    for (var c = 0u; c < 3u; c++) {
        directions[at + c * n] = spectral[c];
        directions[params.slot + at + c * n] = rotated[c];
    }
}

@compute @workgroup_size(64)
fn cosine_directions(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.z;
    let first_row = group.y * 8u;
    let first_column = group.x * 32u;
    for (var first = 0u; first < params.columns; first += DEPTH) {
        workgroupBarrier();
        // Neighbouring invocations read neighbouring elements of z and of the table.
        for (var k = lane; k < 8u * DEPTH; k += 64u) {
            load_mode(b, first_row + k / DEPTH, first + k % DEPTH, k % DEPTH * STRIDE + k / DEPTH);
            let l = first + k / 8u;
            let j = first_column + 4u * (k % 8u);
            factors[k / 8u * STRIDE + k % 8u] =
                vec4f(cosine(l, j), cosine(l, j + 1u), cosine(l, j + 2u), cosine(l, j + 3u));
        }
        workgroupBarrier();
        add_products(lane / 8u, lane % 8u);
    }
    let i = first_row + lane / 8u;
    let j = first_column + 4u * (lane % 8u);
    keep(b, i, j, vec3f(sum0.x, sum1.x, sum2.x), vec3f(sum3.x, sum4.x, sum5.x));
    keep(b, i, j + 1u, vec3f(sum0.y, sum1.y, sum2.y), vec3f(sum3.y, sum4.y, sum5.y));
    keep(b, i, j + 2u, vec3f(sum0.z, sum1.z, sum2.z), vec3f(sum3.z, sum4.z, sum5.z));
    keep(b, i, j + 3u, vec3f(sum0.w, sum1.w, sum2.w), vec3f(sum3.w, sum4.w, sum5.w));
}
