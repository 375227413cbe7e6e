// Inverts the Hessian of a flat sheet in its cosine modes, from Fourier spectrum to Fourier spectrum.
//
// With e_n(k) = exp(-i pi k / 2 n), A = e_H(k) e_W(l) z[k, l] and B = e_H(k) conj(e_W(l)) conj(z[-k, l]), the
// spectrum z of a field in `cosine_order` holds four modes of its cosine transform:
//   cc = Re(A + B) / 2 of (k, l)
//   sc = -Im(A + B) / 2 of (H - k, l)
//   cs = -Im(A - B) / 2 of (k, W - l)
//   ss = Re(B - A) / 2 of (H - k, W - l)
// Each is divided by its eigenvalue lambda, and out[k, l] = conj(e_H(k) e_W(l)) (cc - ss - i (sc + cs)).
//
// cloths: [B]
// row_twiddles: [H], (cos, sin)(pi k / 2 H)
// column_twiddles: [W / 2 + 1], (cos, sin)(pi l / 2 W)
// z, out: [3 B, H, W / 2 + 1] complex
//
// One invocation per element of the spectrum. Workgroups: (H (W / 2 + 1) / 64 over x and y, 3 B in z).
// Adjoint: none, the optimizer is not trained.

struct Params {
    rows: u32, // H
    columns: u32, // W
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cloths: array<Cloth>;
@group(0) @binding(2) var<storage, read> row_twiddles: array<vec2f>;
@group(0) @binding(3) var<storage, read> column_twiddles: array<vec2f>;
@group(0) @binding(4) var<storage, read> z: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> out: array<vec2f>;

fn times(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

// Returns lambda of a mode: inertia, stretch, bend, shear and contacts. `mu` is 2 - 2 cos(pi k / n) along either axis.
fn eigenvalue(mu: vec2f, cloth: Cloth) -> f32 {
    let material = cloth.material;
    let weave = cloth.weave;
    let h = f32(params.rows);
    let w = f32(params.columns);
    let damped = 2.0 * (1.0 + cloth.gravity.w) * material.x;
    let stretch = damped * (weave.x * mu.x / ((h - 1.0) * w) + weave.y * mu.y / (h * (w - 1.0)));
    let bend = 2.0 * material.z * dot(weave.zw * mu, mu);
    return stretch + (1.0 + material.w + bend + 4.0 * material.y * (mu.x + mu.y)) / (h * w);
}

@compute @workgroup_size(64)
fn rest_modes(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let half = params.columns / 2u + 1u;
    let element = (group.y * groups.x + group.x) * 64u + lane;
    if element >= params.rows * half {
        return;
    }
    let k = element / half;
    let l = element % half;
    let field = group.z * params.rows * half;
    let cloth = cloths[group.z / 3u];

    let conj = vec2f(1.0, -1.0);
    let e_h = conj * row_twiddles[k];
    let e_w = conj * column_twiddles[l];
    let opposite = z[field + (params.rows - k) % params.rows * half + l];
    let a = times(times(e_h, e_w), z[field + element]);
    let b = times(times(e_h, conj * e_w), conj * opposite);

    // mu of n - k (x) and of k (y), without the cancellation in 1 - cos.
    let mu_h = 4.0 * row_twiddles[k] * row_twiddles[k];
    let mu_w = 4.0 * column_twiddles[l] * column_twiddles[l];
    let cc = 0.5 * (a.x + b.x) / eigenvalue(vec2f(mu_h.y, mu_w.y), cloth);
    let sc = -0.5 * (a.y + b.y) / eigenvalue(vec2f(mu_h.x, mu_w.y), cloth);
    let cs = -0.5 * (a.y - b.y) / eigenvalue(vec2f(mu_h.y, mu_w.x), cloth);
    let ss = 0.5 * (b.x - a.x) / eigenvalue(vec2f(mu_h.x, mu_w.x), cloth);
    out[field + element] = times(conj * times(e_h, e_w), vec2f(cc - ss, -(sc + cs)));
}
