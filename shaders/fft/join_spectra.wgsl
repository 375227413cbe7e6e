// Joins the half spectra of two real rows into the spectrum of one complex row:
//   z[b, m] = y[b, 2 m] + i y[b, 2 m + 1]
//
// The other half of each spectrum is the conjugate, y[W - k] = conj y[k]. Column 0, and W / 2 of an even W,
// are their own conjugates. Only their real parts count, as in any inverse real transform. A row beyond the
// last is 0.
//
// y: [B, H, K] complex, K = floor(W / 2) + 1
// z: [B, ceil(H / 2), W] complex
//
// One invocation per column of a pair and its conjugate.
// Workgroups: (ceil(H / 2) K / 64 over x and y, B in z).
// Adjoint: `split_spectra`, with the columns that also stand for their conjugates doubled.

struct Params {
    rows: u32, // H
    columns: u32, // W
    count: u32, // ceil(H / 2) K
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> y: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> z: array<vec2f>;

@compute @workgroup_size(64)
fn join_spectra(
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
    let at = (group.z * params.rows + 2u * pair) * half + k;
    let a = y[at];
    var b = vec2f();
    if 2u * pair + 1u < params.rows {
        b = y[at + half];
    }
    let first = (group.z * ((params.rows + 1u) / 2u) + pair) * params.columns;
    if k == 0u || 2u * k == params.columns {
        z[first + k] = vec2f(a.x, b.x);
    } else {
        z[first + k] = vec2f(a.x - b.y, a.y + b.x);
        z[first + params.columns - k] = vec2f(a.x + b.y, b.x - a.y);
    }
}
