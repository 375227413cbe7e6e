// Multiply-adds on numbers in registers, as many per second as the device can do: the bound on the products of
// the network. Sets y = f(x) + f(x + 1) + f(x - 1), where f applies t <- factor t + term 16 `steps` times.
//
// x, y: quads
//
// One invocation per quad, with three chains of multiply-adds per component. On llvmpipe more of them, or steps
// of the three in turn, need more registers than there are. Workgroups: (quads / 64 over x and y).
// Adjoint: none, training does not use it.

struct Params {
    quads: u32,
    steps: u32,
    factor: f32,
    term: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> y: array<vec4f>;

fn four(start: vec4f, factor: f32, term: f32) -> vec4f {
    var t = start;
    t = factor * t + term;
    t = factor * t + term;
    t = factor * t + term;
    t = factor * t + term;
    return t;
}

fn sixteen(start: vec4f, factor: f32, term: f32) -> vec4f {
    var t = start;
    t = four(t, factor, term);
    t = four(t, factor, term);
    t = four(t, factor, term);
    t = four(t, factor, term);
    return t;
}

@compute @workgroup_size(64)
fn multiply_add(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let at = (group.y * groups.x + group.x) * 64u + lane;
    if at >= params.quads {
        return;
    }
    let factor = params.factor;
    let term = params.term;
    var a = x[at];
    var b = a + 1.0;
    var c = a - 1.0;
    for (var step = 0u; step < params.steps; step++) {
        a = sixteen(a, factor, term);
        b = sixteen(b, factor, term);
        c = sixteen(c, factor, term);
    }
    y[at] = a + b + c;
}
