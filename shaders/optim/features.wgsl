// Input of the network: normalised fields and the position of each particle (paper section 3.3, Eq. 7).
//
// embedded[s] = [10 tanh(g / s_g / 10), 10 tanh(g_last / s_g / 10), 10 tanh(d_last / s_d / 10),
//                i / (H-1), j / (W-1)]
// with s_g = |g| / sqrt n and s_d = |d_last| / sqrt n.
//
// fields, partial_sums: see `shaders/pieces/features.wgsl`
// embedded: [s, H, 5, Q] quads, zero in the padding, for the s samples from `first` on
//
// One invocation per quad. Workgroups: (Q / 8, H / 8, s).
// Adjoint: none, the input of the network is a constant of the training step.

struct Params {
    rows: u32, // H
    columns: u32, // W
    row_quads: u32, // Q
    samples: u32, // S
    first: u32, // first of the samples that are embedded
    hidden: u32, // first element of the hidden state in fields
    parts: u32,
    first_sum: u32, // first sum in partial_sums
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> fields: array<f32>;
@group(0) @binding(2) var<storage, read> partial_sums: array<f32>;
@group(0) @binding(3) var<storage, read_write> embedded: array<StoredQuad>;

@compute @workgroup_size(8, 8)
fn features(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_index) index: u32,
    @builtin(workgroup_id) group: vec3u,
) {
    let at = FieldsOf(
        params.first + group.z,
        params.samples,
        params.rows,
        params.columns,
        params.hidden,
        params.parts,
        params.first_sum,
    );
    let inverse = inverse_rms(at, index, 64u);
    if id.x >= params.row_quads || id.y >= params.rows {
        return;
    }
    let out = (id.z * params.rows + id.y) * 5u * params.row_quads + id.x;
    for (var e = 0u; e < 5u; e++) {
        embedded[out + e * params.row_quads] = StoredQuad(feature(at, inverse, e, id.y, id.x));
    }
}
