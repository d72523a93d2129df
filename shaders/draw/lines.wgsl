// lines: tubes about a skeleton, for the centerline and the camera's frustum.
// in   skeleton  a point of the skeleton; normal xyz outwards, w the share of the path up to here
// out  linear colour; what lies ahead of `progress` is dimmed
struct Params {
    clip: mat4x4<f32>,
    origin: vec3<f32>, // mm, moves the skeleton
    radius: f32,       // mm
    turn: vec4<f32>,   // unit quaternion x y z w
    scale: vec3<f32>,
    progress: f32,
    colour: vec3<f32>,
    ahead: f32, // brightness of what lies ahead
}
var<immediate> params: Params;

struct Tube {
    @builtin(position) clip: vec4<f32>,
    @location(0) facing: f32,
    @location(1) share: f32,
}

fn turned(v: vec3<f32>) -> vec3<f32> {
    let q = params.turn;
    return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v);
}

@vertex
fn project(@location(0) skeleton: vec3<f32>, @location(1) normal: vec4<f32>) -> Tube {
    let n = turned(normal.xyz);
    let world = params.origin + turned(skeleton * params.scale) + params.radius * n;
    // The last row of the projection is the viewing direction.
    let facing = -(params.clip * vec4(n, 0.0)).w;
    return Tube(params.clip * vec4(world, 1.0), facing, normal.w);
}

@fragment
fn shade(tube: Tube) -> @location(0) vec4<f32> {
    let lit = 0.25 + 0.75 * max(tube.facing, 0.0);
    let bright = select(params.ahead, 1.0, tube.share <= params.progress);
    return vec4(params.colour * lit * bright, 1.0);
}
