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

#include "lib/contrast.wgsl"
#include "lib/whole.wgsl"

@fragment
fn gather(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let first = params.grid * vec2<i32>(at.xy);
    var sum = vec4(0.0);
    for (var i = 0; i < params.grid * params.grid; i++) {
        let p = min(first + vec2(i % params.grid, i / params.grid), params.size - 1);
        let light = light_of(textureLoad(picture, p, 0).rgb);
        let guide = guide_of(textureLoad(wall, p, 0));
        sum += vec4(guide, light, guide * light, guide * guide);
    }
    return sum / f32(params.grid * params.grid);
}
