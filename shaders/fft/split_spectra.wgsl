// Splits the spectrum of a complex row into the half spectra of the two real rows packed in it (see
// `pack_pairs`):
//   y[b, 2 m, k] = (z[b, m, k] + conj z[b, m, W - k]) / 2
//   y[b, 2 m + 1, k] = (z[b, m, k] - conj z[b, m, W - k]) / 2i
//
// z: [B, ceil(H / 2), W] complex
// y: [B, H, K] complex, K = floor(W / 2) + 1
//
// One invocation per column of a pair. Workgroups: (ceil(H / 2) K / 64 over x and y, B in z).
// Adjoint: `join_spectra`, with the columns that also stand for their conjugates halved.

struct Params {
    rows: u32, // H
    columns: u32, // W
    count: u32, // ceil(H / 2) K
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> z: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> y: array<vec2f>;

@compute @workgroup_size(64)
fn split_spectra(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let element = (group.y * groups.x + group.x) * 64u + lane;
    if element >= params.count {
        return;
    }
    let half = params.columns / 2u + 1u;
    let pair = element / half;
    let k = element % half;
    let first = (group.z * ((params.rows + 1u) / 2u) + pair) * params.columns;
    let a = z[first + k];
    let b = z[first + (params.columns - k) % params.columns];
    let out = (group.z * params.rows + 2u * pair) * half + k;
    y[out] = 0.5 * vec2f(a.x + b.x, a.y - b.y);
    if 2u * pair + 1u < params.rows {
        y[out + half] = 0.5 * vec2f(a.y + b.y, b.x - a.x);
    }
}
