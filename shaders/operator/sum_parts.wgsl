// Adds the parts of a gradient to it, in order: gradient[k] += sum_part partial[part, k].
//
// partial: [parts, stride] quads
// gradient: [stride] quads
//
// One invocation per quad. Workgroups: (stride / 64).
// Adjoint: none, it is part of one.

struct Params {
    stride: u32,
    parts: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> partial: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> gradient: array<vec4f>;

@compute @workgroup_size(64)
fn sum_parts(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.stride {
        return;
    }
    var sum = vec4f();
    for (var part = 0u; part < params.parts; part++) {
        sum += partial[part * params.stride + id.x];
    }
    gradient[id.x] += sum;
}
