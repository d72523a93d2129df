// contrast_gather: logarithms of light and depth of a picture, means over squares of pixels.
// in   picture  linear colour
//      wall     depth of the picture's pixels, reversed; 0 where there is no wall
// out  guide, light, guide times light, guide squared: guide is the logarithm of the depth in near
//      planes, light that of the luminance
struct Params {
    size: vec2<i32>, // of the part of the picture that is raised, from its first pixel
    grid: i32,       // pixels along a square
}
var<immediate> params: Params;
@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var wall: texture_depth_2d;

const DARKEST: f32 = 0.001;
const FARTHEST: f32 = 0.0001;

@vertex
fn whole(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    let corner = vec2(f32((i << 1u) & 2u), f32(i & 2u));
    return vec4(corner * 2.0 - 1.0, 0.0, 1.0);
}

@fragment
fn gather(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let first = params.grid * vec2<i32>(at.xy);
    var sum = vec4(0.0);
    for (var i = 0; i < params.grid * params.grid; i++) {
        let p = min(first + vec2(i % params.grid, i / params.grid), params.size - 1);
        let luminance = dot(textureLoad(picture, p, 0).rgb, vec3(0.2126, 0.7152, 0.0722));
        let light = log(max(luminance, DARKEST));
        let guide = -log(max(textureLoad(wall, p, 0), FARTHEST));
        sum += vec4(guide, light, guide * light, guide * guide);
    }
    return sum / f32(params.grid * params.grid);
}
