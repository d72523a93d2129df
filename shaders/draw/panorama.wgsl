// panorama: the whole sphere about the eye on an equirectangular map, from the six faces of a cube.
// in   faces  3 x 2 squares: front, right, back; left, up, down; each a texel wider on every side
//             than its quarter of the sphere, so that colours can be taken between texels at seams
// out  linear colour; the viewing direction is in the middle, up is up, 2 pi wide and pi high
// src  equirectangular (plate carree) projection, Snyder 1987, doi:10.3133/pp1395, p. 90
struct Params {
    origin: vec2<f32>, // of the map, pixels
    size: vec2<f32>,   // of the map, pixels
    side: f32,         // of a face, texels
}
var<immediate> params: Params;
@group(0) @binding(0) var faces: texture_2d<f32>;

const PI: f32 = 3.14159265;

#include "lib/whole.wgsl"

// A place on a face, right and down, 1 at the edge of its quarter; z is the face.
fn on_cube(d: vec3<f32>) -> vec3<f32> {
    let a = abs(d);
    if a.y > max(a.x, a.z) {
        let down = select(d.z, -d.z, d.y > 0.0);
        return vec3(vec2(d.x, down) / a.y, select(5.0, 4.0, d.y > 0.0));
    }
    if a.x > a.z {
        let right = select(-d.z, d.z, d.x > 0.0);
        return vec3(vec2(right, -d.y) / a.x, select(3.0, 1.0, d.x > 0.0));
    }
    let right = select(-d.x, d.x, d.z < 0.0);
    return vec3(vec2(right, -d.y) / a.z, select(2.0, 0.0, d.z < 0.0));
}

@fragment
fn unroll(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let p = (at.xy - params.origin) / params.size;
    let longitude = (p.x - 0.5) * 2.0 * PI;
    let latitude = (0.5 - p.y) * PI;
    let level = cos(latitude);
    let place =
        on_cube(vec3(sin(longitude) * level, sin(latitude), -cos(longitude) * level));
    let half = 0.5 * params.side;
    let texel = half + (half - 1.0) * place.xy - 0.5;
    let low = clamp(floor(texel), vec2(0.0), vec2(params.side - 2.0));
    let part = clamp(texel - low, vec2(0.0), vec2(1.0));
    let corner = params.side * vec2(place.z % 3.0, floor(place.z / 3.0));
    let i = vec2<i32>(corner + low);
    let top = mix(textureLoad(faces, i, 0), textureLoad(faces, i + vec2(1, 0), 0), part.x);
    let below =
        mix(textureLoad(faces, i + vec2(0, 1), 0), textureLoad(faces, i + vec2(1, 1), 0), part.x);
    return mix(top, below, part.y);
}
