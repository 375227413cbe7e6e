// What each body does to each cloth at the end of a frame, before the state moves there.
//
// contacts: [B, SLOTS, n]
// bodies: [B, count]
// fields: the distances of bodies that are meshes
// a: [B, 3, n]
// given: base [B, 3, n], and more
// x: [B, 3, n]
// report: [B, count, 8] = particles that touch, largest depth below the surface, load (x, y, z), work of the
//   friction, energy, 0 (`sim::BodyStats`)
//
// One workgroup per cloth and body. Its invocations stride over the particles; sums have a fixed order.
// Workgroups: (count, B).
// Adjoint: none, nothing depends on it.

struct Params {
    particles: u32, // n
    bodies: u32, // most of a cloth
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> contacts: array<Contact>;
@group(0) @binding(2) var<storage, read> bodies: array<Body>;
@group(0) @binding(3) var<storage, read> a: array<f32>;
@group(0) @binding(4) var<storage, read> given: array<f32>;
@group(0) @binding(5) var<storage, read> x: array<f32>;
@group(0) @binding(6) var<storage, read> fields: array<f32>;
@group(0) @binding(7) var<storage, read_write> report: array<vec4f>;

override SLOTS: u32 = 1;

var<workgroup> firsts: array<vec4f, 64>; // touching, deepest, load x and y
var<workgroup> seconds: array<vec4f, 64>; // load z, work, energy, 0

@compute @workgroup_size(64)
fn contact_report(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let n = params.particles;
    let number = group.x;
    let b = group.y;
    let body = bodies[b * params.bodies + number];
    var touching = 0.0;
    var deepest = 0.0;
    var load = vec3f();
    var work = 0.0;
    var energy = 0.0;
    for (var p = lane; p < n; p += 64u) {
        for (var k = 0u; k < SLOTS; k++) {
            let one = contacts[(b * SLOTS + k) * n + p];
            if one.body != number || all(one.gradient == vec3f()) {
                continue;
            }
            let y = displacement(b, p, n);
            let at = b * 3u * n + p;
            let place = vec3f(x[at], x[at + n], x[at + 2u * n]) + y;
            let own = inward(body.to_position, body.to_rotation, place);
            deepest = max(deepest, -distance_to(body, own).w);
            energy += contact_energy(one, y);
            if contact_depth(one, y) > 0.0 {
                let slip = contact_slip(one, y);
                let rub = one.friction / max(length(slip), STICKING) * slip;
                touching += 1.0;
                load += contact_gradient(one, y);
                work += dot(rub, slip);
            }
        }
    }
    firsts[lane] = vec4f(touching, deepest, load.xy);
    seconds[lane] = vec4f(load.z, work, energy, 0.0);
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            let more = firsts[lane + half];
            let less = firsts[lane];
            firsts[lane] = vec4f(less.x + more.x, max(less.y, more.y), less.zw + more.zw);
            seconds[lane] += seconds[lane + half];
        }
    }
    if lane == 0u {
        let to = 2u * (b * params.bodies + number);
        report[to] = firsts[0];
        report[to + 1u] = seconds[0];
    }
}
