// ui: triangles of panels, text and panes
// in   at       pixels from the top left of the target
//      uv       0 to 1 across the picture
//      colour   premultiplied, encoded as sRGB
//      picture  premultiplied, encoded as sRGB
// out  encoded colour; everything is multiplied and blended as it is encoded (as egui expects)
struct Params {
    size: vec2<f32>, // of the target, pixels
}
var<immediate> params: Params;
@group(0) @binding(0) var picture: texture_2d<f32>;

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) uv: vec2<f32>,
    @location(1) colour: vec4<f32>,
}

@vertex
fn project(
    @location(0) at: vec2<f32>,
    @location(1) uv: vec2<f32>,
    @location(2) colour: vec4<f32>,
) -> Corner {
    return Corner(vec4(2.0 * at / params.size - 1.0, 0.0, 1.0), uv, colour);
}

fn texel(at: vec2<i32>) -> vec4<f32> {
    let last = vec2<i32>(textureDimensions(picture)) - 1;
    return textureLoad(picture, clamp(at, vec2(0), last), 0);
}

// Between four texels, without a sampler: the same on every device.
@fragment
fn filtered(c: Corner) -> @location(0) vec4<f32> {
    let at = c.uv * vec2<f32>(textureDimensions(picture)) - 0.5;
    let low = floor(at);
    let part = at - low;
    let i = vec2<i32>(low);
    let top = mix(texel(i), texel(i + vec2(1, 0)), part.x);
    let below = mix(texel(i + vec2(0, 1)), texel(i + vec2(1, 1)), part.x);
    return c.colour * mix(top, below, part.y);
}

@fragment
fn nearest(c: Corner) -> @location(0) vec4<f32> {
    return c.colour * texel(vec2<i32>(floor(c.uv * vec2<f32>(textureDimensions(picture)))));
}
