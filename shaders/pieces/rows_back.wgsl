// The inverse cosine transform along the rows of fields of a sheet, less what the reactions of its handles take back:
//   y_f[i, j] = sum_l table[l, j] z[f, i, l],  y'_f = y_f - sum_k reaction_kf y_f(handle_k)
// From the kernel's bindings z [B, 6, H, W] of which FIELDS from FIRST on, handles [B, K] and reactions [B, K, 4, H, W], and parameter room
// (`four_fields`).

// Stands for a handle that there isn't.
const NONE: u32 = 0xffffffffu;

// The fields at two handles, in 32 sums each.
var<workgroup> at_handles: array<vec4f, 64>;

// Returns the fields of a mode, 0 if there is none.
fn mode(b: u32, i: u32, l: u32) -> vec4f {
    let n = params.rows * params.columns;
    var of_mode = vec4f();
    if i < params.rows && l < params.columns {
        let at = (6u * b + FIRST) * n + i * params.columns + l;
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

// Sets the sums to the fields of the tiles whose first row and column are given.
fn transform_back(b: u32, lane: u32, first_row: u32, first_column: u32) {
    clear_sums();
    if STAGED {
        let quads = 8u * TEAMS;
        for (var first = 0u; first < params.columns; first += DEPTH) {
            workgroupBarrier();
            // Neighbouring invocations read neighbouring elements of z and of the table.
            for (var k = lane; k < ROWS * DEPTH; k += LANES) {
                fields[k % DEPTH * STRIDE + k / DEPTH] = mode(b, first_row + k / DEPTH, first + k % DEPTH);
            }
            for (var k = lane; k < quads * DEPTH; k += LANES) {
                factors[place_of(k % quads, k / quads)] =
                    quad_along(first + k / quads, first_column + 4u * (k % quads));
            }
            workgroupBarrier();
            add_products(lane);
        }
    } else {
        let i = first_row + row_of(lane);
        let j = first_column + 4u * quad_of(lane);
        // Not plainly a parameter: see `cosine_columns`.
        let columns = params.columns + (lane >> 31u);
        for (var l = 0u; l < columns; l++) {
            add_product(mode(b, i, l), quad_along(l, j));
        }
    }
}

// The reaction of a handle at four columns of a row, in space or along t1, and across or along t2.
struct Reaction {
    first: vec4f,
    second: vec4f,
}

// Returns the reaction of handle k at four columns from column j on of row i, those of the last row and column past them.
fn reaction(k: u32, i: u32, j: u32) -> Reaction {
    let components = select(vec2u(1u, 2u), vec2u(0u, 3u), FIELDS > 2u);
    return Reaction(of_component(4u * k + components.x, i, j), of_component(4u * k + components.y, i, j));
}

fn of_component(component: u32, i: u32, j: u32) -> vec4f {
    let row = (component * params.rows + min(i, params.rows - 1u)) * params.columns;
    let last = params.columns - 1u;
    return vec4f(
        reactions[row + min(j, last)],
        reactions[row + min(j + 1u, last)],
        reactions[row + min(j + 2u, last)],
        reactions[row + min(j + 3u, last)],
    );
}

// Takes the reaction of a handle back, given the fields there.
fn react(to: Reaction, at_handle: vec4f) {
    sum0 -= at_handle.x * to.first;
    if FIELDS > 2u {
        sum1 -= at_handle.y * to.first;
        sum2 -= at_handle.z * to.first;
        sum3 -= at_handle.w * to.second;
    } else {
        sum1 -= at_handle.y * to.second;
    }
}

// Takes the reactions of all handles of a cloth back, in four columns from column j on of row i. Each workgroup transforms their fields for itself,
// those of two at a time. What does not wait for them is loaded before.
fn react_to_handles(b: u32, lane: u32, i: u32, j: u32) {
    let end = (b + 1u) * params.room;
    // Not plainly a parameter: see `cosine_columns`.
    let columns = params.columns + (lane >> 31u);
    for (var k = b * params.room; k < end && handles[k] != NONE; k += 2u) {
        let next = min(k + 1u, end - 1u);
        let has_next = k + 1u < end && handles[next] != NONE;
        let first = reaction(k, i, j);
        let second = reaction(next, i, j);
        let handle = min(handles[select(k, next, lane >= 32u)], params.rows * params.columns - 1u);
        var sum = vec4f();
        if lane < 64u {
            for (var l = lane % 32u; l < columns; l += 32u) {
                sum += cosine(l, handle % params.columns) * mode(b, handle / params.columns, l);
            }
        }
        workgroupBarrier();
        if lane < 64u {
            at_handles[lane] = sum;
        }
        for (var half = 16u; half > 0u; half /= 2u) {
            workgroupBarrier();
            if lane < 64u && lane % 32u < half {
                at_handles[lane] += at_handles[lane + half];
            }
        }
        workgroupBarrier();
        react(first, at_handles[0]);
        if has_next {
            react(second, at_handles[32]);
        }
    }
}
