// surface: the wall, seen from within by head-light, or from outside as glass.
// in   position  LPS mm; normal xyz unit, into the lumen; normal w k / (1 + |k|) with k the mean
//      curvature times mean radius, plus a half: 0 on a plain tube, positive on ridges
// out  linear colour; `ghost` and `shell` are layers of glass, colour premultiplied, a = opacity of
//      `ghost`, transmittance of `shell`
// src  Blinn 1977, doi:10.1145/563858.563893
// ours light and ambient fall off with distance; curvature shifts colour as crevices do
//
// Fragments work in camera space, where the pixel and its depth say where they are: four numbers
// are interpolated instead of seven, and none of them is the place. Lengths there are counted in
// distances at which light is halved, and the ray through a pixel in pixels.
struct Params {
    turn: vec4<f32>, // unit quaternion, camera from world
    eye: vec3<f32>,  // mm
    near: f32,       // of clip space
    light: vec3<f32>, // camera space; `inside` has it straight above the eye
    scale: f32,       // w of clip space a mm: the place is the pixel's ray times w
    focal: vec2<f32>,  // clip x and y of what lies one unit beside the axis; y down
    middle: vec2<f32>, // pixel of the axis
    depth: f32,        // pixels from the eye to the picture
    opacity: f32,      // of glass: 1 as it is, 0 none, 2 solid
}
var<immediate> params: Params;
// Of refined faces, by slot: fineness inside and on the three sides, a byte each, 32 to a level.
@group(0) @binding(0) var<storage, read> fineness_of_slots: array<u32>;

// Pale, wet tissue. The diffuse part is the cube of the cosine and hardly any light fills in: under a
// lamp this near, slopes of a wall that faces it show only so.
// Constants, not parameters, which software devices are slow to fetch.
const TISSUE = vec3<f32>(0.71, 0.30, 0.23);
const PALE = vec3<f32>(0.86, 0.56, 0.45); // ridges go towards it
const DEEP = vec3<f32>(0.44, 0.12, 0.095); // crevices
const TINT: f32 = 0.35; // how far
const CAVITY: f32 = 0.5; // share of light that a full ridge gains and a crevice loses
const EXPOSURE: f32 = 1.75; // before the tone curve
const AMBIENT: f32 = EXPOSURE * 0.03;
const DIFFUSE: f32 = EXPOSURE * 0.9;
const SPECULAR: f32 = EXPOSURE * 0.2;
const POWER: f32 = 60.0;
const RELIEF: f32 = 0.45; // weight of curvature seen from outside
const OUTSIDE = vec3<f32>(0.76, 0.24, 0.175); // of the wall there

struct Wall {
    @builtin(position) @invariant at: vec4<f32>, // to fragments: pixel, depth, 1 / w
    @location(0) normal: vec4<f32>, // camera space
    // Middle, depth, and y of the light. Software devices fetch a parameter for each lane of each
    // fragment; what is the same all over a triangle they fetch once.
    @location(1) @interpolate(flat) same: vec4<f32>,
}

// The same with a colour of its own.
struct ColouredWall {
    @builtin(position) @invariant at: vec4<f32>,
    @location(0) normal: vec4<f32>,
    @location(1) @interpolate(flat) same: vec4<f32>,
    @location(2) colour: vec4<f32>, // linear; a = share of the tissue's colour that it replaces
}

fn turned(v: vec3<f32>) -> vec3<f32> {
    let q = params.turn;
    return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v);
}

fn projected(position: vec3<f32>, normal: vec4<f32>) -> Wall {
    let p = turned(position - params.eye) * params.scale;
    return Wall(
        vec4(params.focal * p.xy, params.near, -p.z),
        vec4(turned(normal.xyz), normal.w),
        vec4(params.middle, params.depth, params.light.y),
    );
}

@vertex
fn project(@location(0) position: vec3<f32>, @location(1) normal: vec4<f32>) -> Wall {
    return projected(position, normal);
}

@vertex
fn project_coloured(
    @location(0) position: vec3<f32>,
    @location(1) normal: vec4<f32>,
    @location(2) colour: vec4<f32>,
) -> ColouredWall {
    let wall = projected(position, normal);
    return ColouredWall(wall.at, wall.normal, wall.same, colour);
}

// A vertex of a patch that stays on the device. It moves from the edge that it splits to its own
// place. Bits of `carrier`: 5 for the bit of the patch's word at which the fineness begins that the
// vertex follows; 8 for 32 times the level at which the vertex is inserted; the slot of its face.
// Twin: `lod::morph`.
struct PatchVertex {
    @location(0) position: vec3<f32>,
    @location(1) normal: vec4<f32>,
    @location(2) edge_position: vec3<f32>,
    @location(3) edge_normal: vec4<f32>,
    @location(4) carrier: u32,
}

fn morphed(vertex: PatchVertex, word: u32) -> Wall {
    let fineness = (word >> (vertex.carrier & 31u)) & 255u;
    let born = (vertex.carrier >> 5u) & 255u;
    let gone = clamp(i32(fineness) + 32 - i32(born), 0, 32);
    let share = f32(gone) * (1.0 / 32.0);
    return projected(
        vertex.edge_position * (1.0 - share) + vertex.position * share,
        vertex.edge_normal * (1.0 - share) + vertex.normal * share,
    );
}

@vertex
fn project_patch(vertex: PatchVertex, @builtin(instance_index) word: u32) -> Wall {
    return morphed(vertex, word);
}

// The same of refined faces, all of an eye in one draw. `first`: where the eye's slots begin.
@vertex
fn project_face(vertex: PatchVertex, @builtin(instance_index) first: u32) -> Wall {
    return morphed(vertex, fineness_of_slots[first + (vertex.carrier >> 13u)]);
}

fn plain(wall: ColouredWall) -> Wall {
    return Wall(wall.at, wall.normal, wall.same);
}

// Not `normalize`: compilers guard that against overflow, which costs more than all the rest.
fn unit(v: vec3<f32>) -> vec3<f32> {
    return v * inverseSqrt(dot(v, v));
}

// From the eye to the pixel.
fn ray(wall: Wall) -> vec3<f32> {
    return vec3(wall.at.x - wall.same.x, wall.same.y - wall.at.y, -wall.same.z);
}

// Where the wall is.
fn place(wall: Wall, ray: vec3<f32>) -> vec3<f32> {
    return ray * (1.0 / wall.at.w);
}

// Ridges pale and bright, crevices deep and dark. With four samples a fragment at the rim of a triangle
// may have a curvature from beyond the triangle.
fn tinted(extrapolated: f32) -> vec3<f32> {
    let curvature = clamp(extrapolated, -1.0, 1.0);
    let way = select(TISSUE - DEEP, PALE - TISSUE, curvature > 0.0);
    return (TISSUE + (TINT * curvature) * way) * (1.0 + CAVITY * curvature);
}

// 1 / sqrt(x) but for 0.065 per cent: exponent halved as an integer, one step of Newton's with
// constants that even the error out (Kadlec 2010).
fn rough_inverse_sqrt(x: f32) -> f32 {
    let y = bitcast<f32>(0x5F1FFFF9u - (bitcast<u32>(x) >> 1u));
    return y * (0.703952253 * (2.38924456 - x * y * y));
}

// Light from a wall of some colour under a head-light, times exposure. With the light at (0, l, 0) and the wall
// at `ray` times `far`, products with what leads from one to the other are sums of products with
// `ray`, which are needed anyway.
fn lit_wall(wall: Wall, front: bool, colour: vec3<f32>) -> vec3<f32> {
    let ray = ray(wall);
    let far = 1.0 / wall.at.w;
    let l = wall.same.w;
    let n = wall.normal.xyz * select(-1.0, 1.0, front);
    let nn = dot(n, n);
    let n_ray = dot(n, ray);
    let ray2 = dot(ray, ray);
    let above = l * ray.y;
    let light_ray = above - far * ray2;
    let away = l * l - far * (above + light_ray);
    let by_light = rough_inverse_sqrt(nn * away);
    let by_view = rough_inverse_sqrt(nn * ray2);
    let cos_light = (l * n.y - far * n_ray) * by_light;
    let cos_view = -n_ray * by_view;
    let lit = max(cos_light, 0.0);
    // Falloff and twice the squared cosine to the half vector, by one division.
    let both = max(cos_light + cos_view, 0.0);
    let spread = 1.0 - light_ray * by_light * by_view * nn;
    let faded = 1.0 + away;
    let share = 1.0 / (faded * spread);
    let near = spread * share;
    let square = both * both * faded * share;
    // The power of that cosine as the one of a line near 1: off by 0.003.
    let line = max(square * (POWER / 128.0) + (1.0 - POWER / 64.0), 0.0);
    let l4 = (line * line) * (line * line);
    let l16 = (l4 * l4) * (l4 * l4);
    let gloss = l16 * l16 * lit;
    return (colour * (AMBIENT + DIFFUSE * lit * lit * lit) + SPECULAR * gloss) * near;
}

fn lit_tissue(wall: Wall, front: bool) -> vec3<f32> {
    return lit_wall(wall, front, tinted(wall.normal.w));
}

fn lit_coloured(wall: ColouredWall, front: bool) -> vec3<f32> {
    let colour = mix(tinted(wall.normal.w), wall.colour.rgb, wall.colour.a);
    return lit_wall(plain(wall), front, colour);
}

// The tone curve of Reinhard et al. 2002 (doi:10.1145/566654.566575) with white at 1.2, of the luminance
// (Rec. 709): of each channel, it would take the colour out of bright tissue, and relief with it.
fn toned(light: vec3<f32>) -> vec4<f32> {
    let y = dot(light, vec3(0.2126, 0.7152, 0.0722));
    return vec4(light * ((1.0 + y * (1.0 / 1.44)) / (1.0 + y)), 1.0);
}

@fragment
fn inside(wall: Wall, @builtin(front_facing) front: bool) -> @location(0) vec4<f32> {
    return toned(lit_tissue(wall, front));
}

@fragment
fn inside_coloured(
    wall: ColouredWall,
    @builtin(front_facing) front: bool,
) -> @location(0) vec4<f32> {
    return toned(lit_coloured(wall, front));
}

// The same and sRGB (IEC 61966-2-1) as a fraction: off by 0.47 of 255 at most.
fn encoded(light: vec3<f32>) -> vec4<f32> {
    let x = min(toned(light).rgb, vec3(1.0));
    let over = x * (15.017668168 + x * 164.141531111);
    let under = 1.0 + x * (66.575546120 + x * (142.094631090 - x * 30.836282520));
    // One division for the three.
    let others = under.yzx * under.zxy;
    return vec4(over * others * (1.0 / (under.x * others.x)), 1.0);
}

@fragment
fn inside_encoded(wall: Wall, @builtin(front_facing) front: bool) -> @location(0) vec4<f32> {
    return encoded(lit_tissue(wall, front));
}

@fragment
fn coloured_encoded(
    wall: ColouredWall,
    @builtin(front_facing) front: bool,
) -> @location(0) vec4<f32> {
    return encoded(lit_coloured(wall, front));
}

// Where backs are culled, what is seen is front.
@fragment
fn fronts_encoded(wall: Wall) -> @location(0) vec4<f32> {
    return encoded(lit_tissue(wall, true));
}

// Glass of an opacity, asked to be more or less so.
fn thickened(a: f32) -> f32 {
    return a * min(params.opacity, 1.0) + (1.0 - a) * max(params.opacity - 1.0, 0.0);
}

// Every layer of wall, all of one colour, so that their order does not matter.
@fragment
fn ghost(wall: Wall) -> @location(0) vec4<f32> {
    let rim = 1.0 - abs(dot(unit(wall.normal.xyz), unit(ray(wall))));
    let a = (0.01 + 0.22 * rim * rim * rim) * min(params.opacity, 1.0);
    return vec4(vec3(0.78, 0.62, 0.58) * a, a);
}

// The nearest wall alone: form and outline.
fn form(wall: Wall, tissue: vec3<f32>) -> vec4<f32> {
    let ray = ray(wall);
    let towards = dot(unit(wall.normal.xyz), unit(ray));
    let n = unit(wall.normal.xyz) * select(1.0, -1.0, towards > 0.0);
    let facing = abs(towards);
    let lit = max(dot(n, unit(params.light - place(wall, ray))), 0.0);
    let rim = 1.0 - facing;
    // Seen from outside, what stands into the lumen is a groove.
    let k = -RELIEF * wall.normal.w;
    let colour = tissue * (0.10 + 0.75 * lit) * (1.0 + 0.7 * k);
    let gloss = 0.10 * pow(facing, 40.0);
    let a = thickened(mix(0.34, 0.94, rim * sqrt(rim)));
    return vec4((colour + gloss) * a, 1.0 - a);
}

@fragment
fn shell(wall: Wall) -> @location(0) vec4<f32> {
    return form(wall, OUTSIDE);
}

@fragment
fn shell_coloured(wall: ColouredWall) -> @location(0) vec4<f32> {
    return form(plain(wall), mix(OUTSIDE, wall.colour.rgb, wall.colour.a));
}
