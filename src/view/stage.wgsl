// What the viewer draws: the background, the cloth, bodies, and markers of handles. Colours are linear until `shown`, and
// the light is that of the pictures (src/render/shade.rs), without their shadows.

struct Stage {
    // Rotation to the camera's axes: x right, y up, z towards the eye.
    rotation: mat3x3f,
    // The eye along the camera's axes; the distance of the nearest plane that is drawn.
    eye: vec3f,
    near: f32,
    // From tangents to the picture; what part of the tangent a marker's radius is; the width of the cloth's grid.
    scale: vec2f,
    marker: f32,
    width: u32,
    // Directions of the lights and upwards, along the camera's axes; checker fields per edge, 0 for none.
    key: vec3f,
    fields: f32,
    fill: vec3f,
    up: vec3f,
    front: vec4f,
    back: vec4f,
    handle: vec4f,
    drag: vec4f,
    body: vec4f,
    plane: vec4f,
    sky: vec4f,
    ground: vec4f,
}

@group(0) @binding(0) var<uniform> stage: Stage;

fn along_camera(p: vec3f) -> vec3f {
    return stage.rotation * p - stage.eye;
}

// The depth is reversed: 1 at the nearest plane and 0 at infinity.
fn clip(q: vec3f) -> vec4f {
    return vec4f(stage.scale * q.xy, stage.near, -q.z);
}

// Bright highlights roll off instead of clipping; then the curve of sRGB.
fn shown(colour: vec3f) -> vec4f {
    let rolled = select(colour, 0.8 + 0.2 * (1.0 - exp(-(colour - 0.8) / 0.2)), colour > vec3f(0.8));
    let curve = 1.055 * pow(max(rolled, vec3f(0.0)), vec3f(1.0 / 2.4)) - 0.055;
    return vec4f(select(curve, 12.92 * rolled, rolled <= vec3f(0.0031308)), 1.0);
}

struct Wall {
    @builtin(position) place: vec4f,
    @location(0) height: f32,
}

@vertex fn wall(@builtin(vertex_index) k: u32) -> Wall {
    let at = vec2f(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0);
    return Wall(vec4f(at, 0.0, 1.0), 0.5 - 0.5 * at.y);
}

@fragment fn wall_colour(at: Wall) -> @location(0) vec4f {
    return shown(mix(stage.sky.rgb, stage.ground.rgb, smoothstep(0.0, 1.0, at.height)));
}

struct Cloth {
    @builtin(position) place: vec4f,
    @location(0) normal: vec3f,
    @location(1) at: vec3f,
    @location(2) field: vec2f,
}

@vertex fn cloth(
    @builtin(vertex_index) p: u32,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
) -> Cloth {
    let at = along_camera(position);
    let field = stage.fields * vec2f(f32(p % stage.width), f32(p / stage.width));
    return Cloth(clip(at), stage.rotation * normal, at, field);
}

// Two similar tones with a darker thread between the fields, which vanishes where it is thinner than a pixel.
fn checker(field: vec2f) -> f32 {
    let cell = floor(field);
    let tone = select(0.95, 1.05, fract((cell.x + cell.y) / 2.0) < 0.25);
    let off = abs(field - cell - 0.5);
    return select(tone, 0.86 * tone, max(off.x, off.y) > 0.46);
}

@fragment fn cloth_colour(cloth: Cloth, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let tone = select(1.0, checker(cloth.field), stage.fields > 0.0);
    let n = normalize(select(-cloth.normal, cloth.normal, front));
    let eye = -normalize(cloth.at);
    // Fabric transmits and scatters some light, so shading continues a little beyond the terminator.
    let key = max((dot(n, stage.key) + 0.18) / 1.18, 0.0);
    let sky = 0.5 + 0.5 * dot(n, stage.up);
    let light = vec3f(1.0, 0.96, 0.90) * (1.3 * key)
        + vec3f(0.75, 0.85, 1.0) * (0.13 * max(dot(n, stage.fill), 0.0))
        + vec3f(0.80, 0.88, 1.0) * (0.20 * (0.55 + 0.45 * sky));
    let albedo = tone * select(stage.back.rgb, stage.front.rgb, front);
    let rim = pow(1.0 - clamp(dot(n, eye), 0.0, 1.0), 4.0) * (0.3 + 0.7 * sky);
    let shine = pow(max(dot(n, normalize(stage.key + eye)), 0.0), 24.0);
    return shown(albedo * light + vec3f(0.9, 0.95, 1.0) * (0.16 * rim + 0.045 * shine));
}

struct Body {
    @builtin(position) place: vec4f,
    @location(0) normal: vec3f,
    // Of a plane: the place in it from the middle of what is drawn, as a share of its radius, and in fields.
    @location(1) disc: vec2f,
    @location(2) field: vec2f,
}

// The place of a body: columns of its rotation, each with a component of its position, and of a plane the middle and the radius
// of what is drawn, and fields per metre.
struct Pose {
    @location(2) x: vec4f,
    @location(3) y: vec4f,
    @location(4) z: vec4f,
    @location(5) disc: vec4f,
}

@vertex fn body(@location(0) position: vec3f, @location(1) normal: vec3f, pose: Pose) -> Body {
    let turn = mat3x3f(pose.x.xyz, pose.y.xyz, pose.z.xyz);
    let at = along_camera(turn * position + vec3f(pose.x.w, pose.y.w, pose.z.w));
    let share = (position.xy - pose.disc.xy) / max(pose.disc.z, 1e-9);
    return Body(clip(at), stage.rotation * (turn * normal), share, pose.disc.w * position.xy);
}

fn matte(normal: vec3f) -> vec3f {
    let n = normalize(normal);
    let key = 0.5 + 0.5 * dot(n, stage.key);
    let sky = 0.5 + 0.5 * dot(n, stage.up);
    return vec3f(1.0, 0.97, 0.93) * (1.05 * key * key)
        + vec3f(0.75, 0.85, 1.0) * (0.10 * max(dot(n, stage.fill), 0.0))
        + vec3f(0.86, 0.91, 1.0) * (0.12 + 0.22 * sky);
}

@fragment fn body_colour(body: Body) -> @location(0) vec4f {
    return shown(stage.body.rgb * matte(body.normal));
}

// A plane fades towards its edge.
@fragment fn plane_colour(body: Body) -> @location(0) vec4f {
    let edge = clamp((1.0 - length(body.disc)) / 0.55, 0.0, 1.0);
    let apart = abs(body.field - round(body.field));
    let width = fwidth(body.field);
    let line = 1.0 - min(smoothstep(0.014, 0.014 + width.x, apart.x), smoothstep(0.014, 0.014 + width.y, apart.y));
    let colour = shown(stage.plane.rgb * matte(body.normal) * mix(1.0, 0.88, line));
    return vec4f(colour.rgb, edge * edge * (3.0 - 2.0 * edge));
}

struct Marker {
    @builtin(position) place: vec4f,
    @location(0) across: vec2f,
    @location(1) @interpolate(flat) drag: f32,
}

// A marker is a ball of the same size on the screen wherever it is, drawn as a square that faces the eye.
@vertex fn marker(@builtin(vertex_index) k: u32, @location(0) position: vec4f) -> Marker {
    let corner = vec2f(f32(k & 1u) * 2.0 - 1.0, f32(k >> 1u) * 2.0 - 1.0);
    let at = along_camera(position.xyz);
    let nearer = at * (1.0 - 1.5 * stage.marker);
    return Marker(clip(nearer + vec3f(corner * stage.marker * -nearer.z, 0.0)), corner, position.w);
}

@fragment fn marker_colour(marker: Marker) -> @location(0) vec4f {
    let r = dot(marker.across, marker.across);
    if r > 1.0 {
        discard;
    }
    let n = vec3f(marker.across, sqrt(1.0 - r));
    let key = 0.5 + 0.5 * dot(n, stage.key);
    let shine = pow(max(dot(n, normalize(stage.key + vec3f(0.0, 0.0, 1.0))), 0.0), 40.0);
    let colour = mix(stage.handle.rgb, stage.drag.rgb, marker.drag);
    return shown(colour * (0.42 + 0.75 * key * key) + 0.45 * shine);
}
