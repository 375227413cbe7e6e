// The part of a start that goes on as the accelerations of the last frames did: the smooth part S of slot 0 of the directions, which
// `sheet_axes` sets to (2 - WARMEST) last - earlier.
//
//   S v (i, j) = sum_k sum_l w_|k| w_|l| v(i + k, j + l) / sum_k sum_l w_|k| w_|l|,  k, l = -4..4,
// over the free particles; beyond a border the sheet goes on as its mirror image.
//
// marks: [B, n]
// directions: [K, slot], [B, 3, n] each, slot 0 being 0 where no free particle is; slot 1 becomes S times slot 0, and 0 there
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    slot: u32, // elements from a direction to the next, at least 3 B n
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<vec2u>;
@group(0) @binding(2) var<storage, read_write> directions: array<f32>;

// Rows and columns that a value takes from, on each side.
const REACH: u32 = 4;

// The weights w, from the middle outwards.
override W0: f32 = 0.2734375;
override W1: f32 = 0.21875;
override W2: f32 = 0.109375;
override W3: f32 = 0.03125;
override W4: f32 = 0.00390625;

// Returns the weight of the row or column with this number, counted from REACH ahead of the middle.
fn weight(at: u32) -> f32 {
    let distance = max(at, REACH) - min(at, REACH);
    if distance == 0u {
        return W0;
    }
    let far = select(W3, W4, distance == 4u);
    let near = select(W1, W2, distance == 2u);
    return select(near, far, distance > 2u);
}

// Returns the row or column, of `count`, that stands for number `at`, counted from REACH ahead of the first.
fn mirrored(at: u32, count: u32) -> u32 {
    let inside = select(at - REACH, REACH - 1u - at, at < REACH);
    return select(2u * count - 1u - inside, inside, inside < count);
}

@compute @workgroup_size(64)
fn extrapolate(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    if p >= n {
        return;
    }
    let b = group.z;
    let first = b * 3u * n;
    let i = p / params.columns;
    let j = p % params.columns;
    // The sum of the values, and that of their weights.
    var sum = vec4f();
    for (var k = 0u; k <= 2u * REACH; k++) {
        let row = mirrored(i + k, params.rows) * params.columns;
        var along = vec4f();
        for (var l = 0u; l <= 2u * REACH; l++) {
            let q = row + mirrored(j + l, params.columns);
            let at = first + q;
            let free = select(0.0, 1.0, is_free(marks[b * n + q]));
            along += weight(l) * vec4f(directions[at], directions[at + n], directions[at + 2u * n], free);
        }
        sum += weight(k) * along;
    }
    let free = is_free(marks[b * n + p]);
    for (var c = 0u; c < 3u; c++) {
        directions[params.slot + first + c * n + p] = select(0.0, sum[c] / sum.w, free);
    }
}
