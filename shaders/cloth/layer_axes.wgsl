// Start of a frame of a subspace method: shortens the axes of the sheet (`sheet_axes`) at the particles that other layers hold.
//
// With the sum r of what its pairs resist (`terms/contact`), each times its squared weight in the pair, a particle's t1, t2 and
// normal become (1 + HOLDING n r)^(-1/2) of what they were.
//
// ends: [B, buckets], where the list of each particle ends
// corners: [B, 4 room], see `layer_list`
// pairs: [B, room]
// a: [B, 3, n]
// given: base [B, 3, n], and more
// axes: [B, 16, n], of which the first nine change
//
// One invocation per particle. Workgroups: (n / 64 over x and y, B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
    buckets: u32,
    room: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> ends: array<u32>;
@group(0) @binding(2) var<storage, read> corners: array<u32>;
@group(0) @binding(3) var<storage, read> pairs: array<Pair>;
@group(0) @binding(4) var<storage, read> a: array<f32>;
@group(0) @binding(5) var<storage, read> given: array<f32>;
@group(0) @binding(6) var<storage, read_write> axes: array<f32>;

override HOLDING: f32 = 1e-3;

@compute @workgroup_size(64)
fn layer_axes(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let n = params.rows * params.columns;
    let p = (group.y * groups.x + group.x) * 64u + lane;
    let b = group.z;
    if p >= n {
        return;
    }
    var resistance = 0.0;
    let last = end_of(b, p, params.buckets, 4u * params.room);
    for (var k = begin_of(b, p, params.buckets); k < last; k++) {
        let corner = corners[b * 4u * params.room + k];
        let pair = pairs[b * params.room + min(corner / 4u, params.room - 1u)];
        let weight = pair.weights[corner % 4u];
        resistance += weight * weight * contact_resistance(pair.contact, across(b, pair));
    }
    let share = inverseSqrt(1.0 + HOLDING * f32(n) * resistance);
    for (var c = 0u; c < 9u; c++) {
        axes[(b * 16u + c) * n + p] *= share;
    }
}
