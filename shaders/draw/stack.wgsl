// stack: lays the finished layers of glass over the picture behind them.
// in   glass  colour of all layers, and in alpha what still shines through them; grid x grid pixels
//             for each of the picture, of which the mean is taken
struct Params {
    grid: u32,
}
var<immediate> params: Params;
@group(0) @binding(0) var glass: texture_2d<f32>;

#include "lib/whole.wgsl"

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
