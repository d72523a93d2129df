// behind: the tissue behind the drawn wall, laid over its picture. Twin: `behind::cast`.
// in   wall    depth of the picture's pixels
//      table   slots of the bricks about the wall, x fastest; 2^32 - 1 outside without a brick, one less
//              inside
//      tiles   9^3 words a slot: the value above -1024 in sixteenths, low half; the distance from the
//              wall in 1/1024 mm, high half, 32768 at the wall
//      opacity colour times share of light taken, and that share, between two values; 256 x 256
// out  premultiplied linear colour; a = share of the picture that it hides
// src  Engel, Kraus & Ertl 2001, doi:10.1145/383507.383515
// ours depth by the distance from the wall; the first sample where the band begins; no jitter
struct Params {
    right: vec4<f32>,  // voxels for each mm along the axes of the camera; w: the eye, voxels
    up: vec4<f32>,
    back: vec4<f32>,
    middle: vec2<f32>, // pixel of the axis
    depth: f32,        // pixels from the eye to the picture
    near: f32,         // mm
    light: f32,        // height of the light above the eye, mm
    falloff: f32,      // distance at which light is halved, mm
    skin: f32,         // depth at which the band begins, voxel sides
    step: f32,         // mm
    band: f32,         // depth at which the band ends, mm
    reach: f32,        // distance from the wall without a brick, mm
    least: f32,        // least step through skin and lumen, mm
    dims_x: i32,       // of the table
    dims_y: i32,
    dims_z: i32,
}
var<immediate> params: Params;
@group(0) @binding(0) var wall: texture_depth_2d;
@group(0) @binding(1) var<storage, read> table: array<u32>;
@group(0) @binding(2) var<storage, read> tiles: array<u32>;
@group(0) @binding(3) var<storage, read> opacity: array<vec4<f32>>;

const SKIN_STEPS: u32 = 32u;
const BAND_STEPS: u32 = 64u;
const LUMEN_STEPS: u32 = 48u;
const MIN_THROUGH: f32 = 0.015;
const SKIN_SHARE: f32 = 0.7;
const MAX_BANDS: f32 = 3.0;
const FIRST_VALUE: f32 = -1024.0;
const ROWS: f32 = 255.0 / 2560.0;
const TISSUE = vec3<f32>(0.62, 0.27, 0.21); // of the wall behind a fold
const DARK = vec3<f32>(0.012, 0.012, 0.016); // beyond the band

struct Ray {
    start: vec3<f32>, // voxels
    per_mm: vec3<f32>,
}

struct Sample {
    value: f32,
    offset: f32,
}

#include "lib/whole.wgsl"

fn unpacked(word: u32) -> vec2<f32> {
    let value = f32(word & 0xffffu) * (1.0 / 16.0) + FIRST_VALUE;
    return vec2(value, (f32(word >> 16u) - 32768.0) * (1.0 / 1024.0));
}

fn sampled(ray: Ray, t: f32) -> Sample {
    return at_voxel(ray.start + t * ray.per_mm);
}

fn at_voxel(p: vec3<f32>) -> Sample {
    let corner = floor(p);
    let s = p - corner;
    let cell = vec3<i32>(corner);
    let brick = cell >> vec3(3u);
    let dims = vec3(params.dims_x, params.dims_y, params.dims_z);
    var slot = 0xffffffffu;
    if all(brick >= vec3(0)) && all(brick < dims) {
        slot = table[u32(brick.x + dims.x * (brick.y + dims.y * brick.z))];
    }
    if slot >= 0xfffffffeu {
        let away = select(-params.reach, params.reach, slot == 0xffffffffu);
        return Sample(FIRST_VALUE, away);
    }
    let local = vec3<u32>(cell & vec3(7));
    let first = slot * 729u + local.x + 9u * (local.y + 9u * local.z);
    let c0 = unpacked(tiles[first]);
    let c1 = unpacked(tiles[first + 1u]);
    let c2 = unpacked(tiles[first + 9u]);
    let c3 = unpacked(tiles[first + 10u]);
    let c4 = unpacked(tiles[first + 81u]);
    let c5 = unpacked(tiles[first + 82u]);
    let c6 = unpacked(tiles[first + 90u]);
    let c7 = unpacked(tiles[first + 91u]);
    let x0 = c0 + (c1 - c0) * s.x;
    let x1 = c2 + (c3 - c2) * s.x;
    let x2 = c4 + (c5 - c4) * s.x;
    let x3 = c6 + (c7 - c6) * s.x;
    let y0 = x0 + (x1 - x0) * s.y;
    let y1 = x2 + (x3 - x2) * s.y;
    let middle = y0 + (y1 - y0) * s.z;
    return Sample(middle.x, middle.y);
}

// Slopes of the distance, mm a voxel, from the corners of a tetrahedron: those of a cell alone jump from
// cell to cell.
fn slopes_at(ray: Ray, t: f32) -> vec3<f32> {
    let p = ray.start + t * ray.per_mm;
    let a = at_voxel(p + vec3(1.0, -1.0, -1.0)).offset;
    let b = at_voxel(p + vec3(-1.0, -1.0, 1.0)).offset;
    let c = at_voxel(p + vec3(-1.0, 1.0, -1.0)).offset;
    let d = at_voxel(p + vec3(1.0)).offset;
    return 0.25 * vec3(a - b - c + d, c + d - a - b, b + d - a - c);
}

// The normal of slopes, out of the lumen, unit, camera space.
fn normal_of(slopes: vec3<f32>) -> vec3<f32> {
    let n = vec3(dot(slopes, params.right.xyz), dot(slopes, params.up.xyz), dot(slopes, params.back.xyz));
    return n * inverseSqrt(max(dot(n, n), 1e-20));
}

// Share of light that a wall gives back, at a place with a normal out of the lumen, and how much of the
// light comes so far.
fn light_on(place: vec3<f32>, normal: vec3<f32>) -> vec2<f32> {
    let to_light = vec3(0.0, params.light, 0.0) - place;
    let away = dot(to_light, to_light);
    let facing = max(-dot(normal, to_light) * inverseSqrt(away), 0.0);
    return vec2(facing, 1.0 / (1.0 + away / (params.falloff * params.falloff)));
}

fn row(value: f32) -> u32 {
    return u32(clamp((value - FIRST_VALUE) * ROWS + 0.5, 0.0, 255.0));
}

@fragment
fn look(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let nearness = textureLoad(wall, vec2<i32>(at.xy), 0);
    if nearness <= 0.0 {
        return vec4(0.0);
    }
    // 1. The ray from the wall outwards.
    let pixel = vec3(at.x - params.middle.x, params.middle.y - at.y, -params.depth);
    let place = pixel * (params.near / (nearness * params.depth));
    let way = pixel * inverseSqrt(dot(pixel, pixel));
    let eye = vec3(params.right.w, params.up.w, params.back.w);
    let ray = Ray(
        eye + params.right.xyz * place.x + params.up.xyz * place.y + params.back.xyz * place.z,
        params.right.xyz * way.x + params.up.xyz * way.y + params.back.xyz * way.z,
    );
    var now = sampled(ray, 0.0);
    let slopes = slopes_at(ray, 0.0);
    let normal = normal_of(slopes);

    // 2. To where the band begins, exactly.
    let skin = params.skin * length(slopes);
    var t = 0.0;
    var step = 0.0;
    var before = now.offset;
    for (var i = 0u; i < SKIN_STEPS; i++) {
        if now.offset >= skin || now.offset < -params.least {
            break;
        }
        // Not past a wall on the other side.
        before = now.offset;
        step = clamp(skin - before, params.least, max(before, 0.0) + params.least);
        t += step;
        now = sampled(ray, t);
    }
    if now.offset > skin && before < skin {
        t -= step * (now.offset - skin) / (now.offset - before);
        now = sampled(ray, t);
    }

    // 3. Through the band.
    var colour = vec3(0.0);
    var through = 1.0;
    var is_done = false;
    var is_out = now.offset < -params.least;
    let end = t + MAX_BANDS * params.band;
    for (var i = 0u; i < BAND_STEPS; i++) {
        if is_out || is_done || through < MIN_THROUGH || t >= end {
            break;
        }
        // Before another wall, small steps: where a ray enters the lumen shows.
        let is_skin = now.offset < SKIN_SHARE * skin;
        step = select(params.step, clamp(now.offset, params.least, params.step), is_skin);
        let next = sampled(ray, t + step);
        if !is_skin {
            let light = opacity[row(now.value) + 256u * row(next.value)];
            // Parts of the piece: before the end of the ray and of the band, and out of the skin.
            let before_end = min((end - t) / step, 1.0);
            let is_last = next.offset > params.band;
            let part = clamp((params.band - now.offset) / (next.offset - now.offset), 0.0, 1.0);
            let beyond = (now.offset / max(skin, 1e-20) - SKIN_SHARE) * (1.0 / (1.0 - SKIN_SHARE));
            let share = before_end * select(1.0, part, is_last) * clamp(beyond, 0.0, 1.0);
            colour += (through * share) * light.rgb;
            through *= 1.0 - share * light.a;
            is_done = is_last;
        }
        t += step;
        now = next;
        is_out = now.offset < 0.0;
    }

    // 4. Through the lumen behind a fold, to the next wall.
    let lit = light_on(place, normal);
    var behind = DARK;
    if is_out && !is_done && through >= MIN_THROUGH {
        for (var i = 0u; i < LUMEN_STEPS; i++) {
            step = max(-0.9 * now.offset, params.least);
            t += step;
            let next = sampled(ray, t);
            if next.offset >= 0.0 {
                t -= step * next.offset / (next.offset - now.offset);
                let on_it = light_on(place + t * way, normal_of(slopes_at(ray, t)));
                behind = TISSUE * (0.08 + 1.1 * on_it.x * on_it.x) * on_it.y;
                break;
            }
            now = next;
        }
    }

    // 5. Behind the wall's own picture, more of it where the wall is seen from the side.
    let side = 1.0 - clamp(dot(normal, way), 0.0, 1.0);
    let hides = 0.7 - 0.35 * side * side * side;
    let shade = (0.35 + 0.65 * lit.x) * lit.y;
    return vec4(hides * (colour * shade + behind * through), hides);
}
