// Energy terms of each cloth from its parts: sums, and for the largest stretch the maximum (see `energy`).
//
// parts: [B, groups, 8]
// terms: [B, 8] = stretch, shear, bend, inertia, external, largest stretch, sum of |stretch|, repulsion
//
// One workgroup per cloth. Its invocations stride over the parts and add up in a fixed order.
// Workgroups: (B).
// Adjoint: `gradient`.

struct Params {
    groups: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> parts: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> terms: array<vec4f>;

var<workgroup> sums: array<vec4f, 64>;
var<workgroup> others: array<vec4f, 64>;

@compute @workgroup_size(64)
fn energy_sum(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let b = group.x;
    var sum = vec4f();
    var other = vec4f(0.0, -1.0, 0.0, 0.0);
    for (var k = lane; k < params.groups; k += 64u) {
        let at = 2u * (b * params.groups + k);
        let more = parts[at + 1u];
        sum += parts[at];
        other = vec4f(other.x + more.x, max(other.y, more.y), other.zw + more.zw);
    }
    sums[lane] = sum;
    others[lane] = other;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            sums[lane] += sums[lane + half];
            let more = others[lane + half];
            let less = others[lane];
            others[lane] = vec4f(less.x + more.x, max(less.y, more.y), less.zw + more.zw);
        }
    }
    if lane == 0u {
        terms[2u * b] = sums[0];
        terms[2u * b + 1u] = others[0];
    }
}
