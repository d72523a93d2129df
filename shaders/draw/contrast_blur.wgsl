// contrast_blur: means over a row or column of texels, and the line that fits them.
// in   values  guide, light, guide times light, guide squared; or slope and offset of lines
// out  blur: means of the values. fit: from means along the second axis, slope and offset of the line
//      light = slope * guide + offset of each window
// src  guided filter, He, Sun & Tang 2013, doi:10.1109/TPAMI.2012.213
struct Params {
    size: vec2<i32>, // of the values
    along: vec2<i32>,
    radius: i32,
    least: f32, // variance of the guide below which the line is flat
}
var<immediate> params: Params;
@group(0) @binding(0) var values: texture_2d<f32>;

#include "lib/whole.wgsl"

fn mean(at: vec2<i32>) -> vec4<f32> {
    var sum = vec4(0.0);
    for (var k = -params.radius; k <= params.radius; k++) {
        sum += textureLoad(values, clamp(at + k * params.along, vec2(0), params.size - 1), 0);
    }
    return sum / f32(2 * params.radius + 1);
}

@fragment
fn blur(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    return mean(vec2<i32>(at.xy));
}

@fragment
fn fit(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let m = mean(vec2<i32>(at.xy));
    let slope = (m.z - m.x * m.y) / (max(m.w - m.x * m.x, 0.0) + params.least);
    return vec4(slope, m.y - slope * m.x, 0.0, 0.0);
}
