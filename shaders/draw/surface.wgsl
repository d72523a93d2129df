// surface: the wall, seen from within by head-light, or from outside as glass.
// in   position  LPS mm; normal xyz unit, into the lumen; normal w k / (1 + |k|) with k the mean
//      curvature times mean radius, plus a half: 0 on a plain tube, positive on ridges
// out  linear colour; `ghost` and `shell` are layers of glass, colour premultiplied, a = opacity
// src  Blinn 1977, doi:10.1145/563858.563893
// ours light and ambient fall off with distance; curvature shifts colour as crevices do
struct Params {
    clip: mat4x4<f32>, // clip from world, reversed depth, y down
    eye: vec3<f32>,
    falloff: f32, // mm at which light is halved
    light: vec3<f32>,
    relief: f32, // weight of curvature
    tissue: vec3<f32>,
    ambient: f32,
    diffuse: f32,
    specular: f32,
    power: f32,
    exposure: f32,
}
var<immediate> params: Params;

struct Wall {
    @builtin(position) @invariant clip: vec4<f32>,
    @location(0) world: vec3<f32>,
    @location(1) normal: vec4<f32>,
}

@vertex
fn project(@location(0) position: vec3<f32>, @location(1) normal: vec4<f32>) -> Wall {
    return Wall(params.clip * vec4(position, 1.0), position, normal);
}

// Not `normalize`: compilers guard that against overflow, which costs more than all the rest.
fn unit(v: vec3<f32>) -> vec3<f32> {
    return v * inverseSqrt(dot(v, v));
}

// Unit normal on the viewer's side.
fn towards(normal: vec3<f32>, view: vec3<f32>) -> vec3<f32> {
    let n = unit(normal);
    return select(-n, n, dot(n, view) >= 0.0);
}

// Ridges pale, crevices deep: `relief` is how far a fold at full scale goes.
fn tinted(curvature: f32) -> vec3<f32> {
    let pale = 0.6 * max(params.relief * curvature, 0.0);
    let deep = max(-params.relief * curvature, 0.0);
    return params.tissue * (1.0 - pale - deep * vec3(0.50, 0.74, 0.72)) + pale * vec3(1.0, 0.58, 0.46);
}

// exp(-x) for x >= 0, off by 0.0016 at most: the fourth power of 1 over the series of exp(x / 4).
fn decay(x: vec3<f32>) -> vec3<f32> {
    let y = 0.25 * x;
    let d = 1.0 / (1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0))));
    return d * d * d * d;
}

// Light from the wall under a head-light, highlights saturating gently.
fn lit_wall(wall: Wall, front: bool) -> vec3<f32> {
    let view = unit(params.eye - wall.world);
    let n = unit(wall.normal.xyz) * select(-1.0, 1.0, front);
    let to_light = params.light - wall.world;
    let away = dot(to_light, to_light);
    let light = to_light * inverseSqrt(away);
    let half = params.falloff * params.falloff;
    let near = half / (half + away);
    let cos_light = dot(n, light);
    let cos_view = dot(n, view);
    // A little light wraps round, as it does in flesh: silhouettes go dark, not black.
    let lit = max((cos_light + 0.15) * (1.0 / 1.15), 0.0);
    // The squared cosine to the half vector, and its power as that of a line near 1: off by
    // 0.003 at a power of 50, and good for 16 and more.
    let both = max(cos_light + cos_view, 0.0);
    let square = both * both / (2.0 + 2.0 * dot(light, view));
    let line = max(1.0 + (square - 1.0) * (params.power / 64.0), 0.0);
    let l4 = (line * line) * (line * line);
    let l16 = (l4 * l4) * (l4 * l4);
    let gloss = l16 * l16;
    // Grazing walls go darker than the cosine alone makes them: the rim of a fold stands out.
    let t = clamp(2.0 * cos_view, 0.0, 1.0);
    let edge = 0.65 + 0.35 * t * t * (3.0 - 2.0 * t);
    let wall_light = (params.ambient + params.diffuse * lit) * near * edge;
    let colour = tinted(wall.normal.w) * wall_light + params.specular * gloss * near * near;
    return 1.0 - decay(params.exposure * colour);
}

// The S lends depth to the shadows.
@fragment
fn inside(wall: Wall, @builtin(front_facing) front: bool) -> @location(0) vec4<f32> {
    let c = lit_wall(wall, front);
    return vec4(c * (0.5 + c * (1.5 - c)), 1.0);
}

// The same S and sRGB (IEC 61966-2-1) as one polynomial in the root, off by 0.6 of 255 at most.
@fragment
fn inside_encoded(wall: Wall, @builtin(front_facing) front: bool) -> @location(0) vec4<f32> {
    let q = sqrt(lit_wall(wall, front));
    let high = 114.29707 + q * (-150.88159 + q * (100.90008 + q * -27.01960));
    return vec4(q * (-0.02430 + q * (9.91162 + q * (-46.18327 + q * high))), 1.0);
}

// Every layer of wall, all of one colour, so that their order does not matter.
@fragment
fn ghost(wall: Wall) -> @location(0) vec4<f32> {
    let view = unit(params.eye - wall.world);
    let rim = 1.0 - abs(dot(unit(wall.normal.xyz), view));
    let a = 0.01 + 0.22 * rim * rim * rim;
    return vec4(vec3(0.78, 0.62, 0.58) * a, a);
}

// The nearest wall alone: form and outline.
@fragment
fn shell(wall: Wall) -> @location(0) vec4<f32> {
    let view = unit(params.eye - wall.world);
    let n = towards(wall.normal.xyz, view);
    let facing = dot(n, view);
    let lit = max(dot(n, unit(params.light - wall.world)), 0.0);
    let rim = 1.0 - facing;
    // Seen from outside, what stands into the lumen is a groove.
    let k = -params.relief * wall.normal.w;
    let colour = params.tissue * (0.10 + 0.75 * lit) * (1.0 + 0.7 * k);
    let gloss = 0.10 * pow(facing, 40.0);
    let a = mix(0.34, 0.94, rim * sqrt(rim));
    return vec4((colour + gloss) * a, a);
}

@fragment
fn nothing(wall: Wall) -> @location(0) vec4<f32> {
    return vec4(0.0);
}
