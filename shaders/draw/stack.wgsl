// stack: lays the finished layers of glass over the picture behind them.
// in   glass  colour of all layers, and in alpha what still shines through them; grid x grid pixels
//             for each of the picture, of which the mean is taken
struct Params {
    grid: u32,
}
var<immediate> params: Params;
@group(0) @binding(0) var glass: texture_2d<f32>;

@vertex
fn whole(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    let corner = vec2(f32((i << 1u) & 2u), f32(i & 2u));
    return vec4(corner * 2.0 - 1.0, 0.0, 1.0);
}

@fragment
fn lay(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let grid = i32(params.grid);
    let first = grid * vec2<i32>(at.xy);
    var sum = vec4(0.0);
    for (var i = 0; i < grid * grid; i++) {
        sum += textureLoad(glass, first + vec2(i % grid, i / grid), 0);
    }
    return sum / f32(grid * grid);
}
