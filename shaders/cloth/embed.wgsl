// Vertices of a mesh that the cloths carry along: position and normal, interpolated from those of the particles.
//
//   value = sum over the corners (i, j) of the vertex's cell: weight(s, i) weight(t, j) value(i, j)
//   normal = the unit vector along the interpolated one; zero if that is zero
//
// cells: [V], the number of the first corner of each vertex's cell
// weights: [V, 2], where in its cell the vertex lies: s along i, t along j
// interleaved: [B, H W, 6], position then normal of each particle
// embedded: [B, V, 6], likewise of each vertex
//
// One invocation per vertex. Workgroups: (V / 64 over x and y, B in z).
// Adjoint: none, rendering is not part of the training loss.

struct Params {
    particles: u32, // H W
    columns: u32, // W
    vertices: u32, // V
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> cells: array<u32>;
@group(0) @binding(2) var<storage, read> weights: array<vec2f>;
@group(0) @binding(3) var<storage, read> interleaved: array<f32>;
@group(0) @binding(4) var<storage, read_write> embedded: array<f32>;

// Returns the three numbers from element `at` on.
fn three(at: u32) -> vec3f {
    return vec3f(interleaved[at], interleaved[at + 1u], interleaved[at + 2u]);
}

// Returns the interpolation of the numbers from element `at` of the first corner on.
fn inside(at: u32, place: vec2f) -> vec3f {
    let before = (1.0 - place.y) * three(at) + place.y * three(at + 6u);
    let next = at + 6u * params.columns;
    let after = (1.0 - place.y) * three(next) + place.y * three(next + 6u);
    return (1.0 - place.x) * before + place.x * after;
}

@compute @workgroup_size(64)
fn embed(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let vertex = (group.y * groups.x + group.x) * 64u + lane;
    if vertex >= params.vertices {
        return;
    }
    let at = 6u * (group.z * params.particles + cells[vertex]);
    let position = inside(at, weights[vertex]);
    let sum = inside(at + 3u, weights[vertex]);
    // Scaled first, so that no square underflows.
    let size = max(max(abs(sum.x), abs(sum.y)), abs(sum.z));
    var normal = vec3f();
    if size > 0.0 {
        normal = normalize(sum / size);
    }
    let to = 6u * (group.z * params.vertices + vertex);
    for (var c = 0u; c < 3u; c++) {
        embedded[to + c] = position[c];
        embedded[to + 3u + c] = normal[c];
    }
}
