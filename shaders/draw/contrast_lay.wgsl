// contrast_lay: a picture whose light departs farther from the smooth light.
// in   picture  linear colour
//      wall     depth of the picture's pixels, reversed; 0 where there is no wall
//      lines    slope and offset of the smooth light over the guide, a square of pixels each
// out  linear colour; beyond the part that is raised, the picture
struct Params {
    size: vec2<i32>, // of the part that is raised, from the first pixel
    grid: i32,       // pixels along a square
    raise: f32,      // share by which light departs farther
    most: f32,       // largest change of the logarithm of light
}
var<immediate> params: Params;
@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var wall: texture_depth_2d;
@group(0) @binding(2) var lines: texture_2d<f32>;

#include "lib/contrast.wgsl"
#include "lib/whole.wgsl"

// Slope and offset between the middles of four squares.
fn line_at(at: vec2<f32>) -> vec2<f32> {
    let most = (params.size + params.grid - 1) / params.grid - 1;
    let place = clamp(at / f32(params.grid) - 0.5, vec2(0.0), vec2<f32>(most));
    let low = vec2<i32>(place);
    let high = min(low + 1, most);
    let part = place - vec2<f32>(low);
    let top = mix(textureLoad(lines, low, 0), textureLoad(lines, vec2(high.x, low.y), 0), part.x);
    let below =
        mix(textureLoad(lines, vec2(low.x, high.y), 0), textureLoad(lines, high, 0), part.x);
    return mix(top, below, part.y).xy;
}

@fragment
fn lay(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let p = vec2<i32>(at.xy);
    let colour = textureLoad(picture, p, 0);
    let depth = textureLoad(wall, p, 0);
    if any(p >= params.size) || depth <= 0.0 {
        return colour;
    }
    let light = light_of(colour.rgb);
    let line = line_at(at.xy);
    let smooth_light = line.x * guide_of(depth) + line.y;
    let change = clamp(params.raise * (light - smooth_light), -params.most, params.most);
    let raised = colour.rgb * exp(change);
    // Of a colour that is too bright the hue stays.
    return vec4(raised / max(1.0, max(raised.r, max(raised.g, raised.b))), colour.a);
}
