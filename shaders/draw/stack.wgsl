// stack: lays the finished layers of glass over the picture behind them.
// in   glass  colour of all layers, and in alpha what still shines through them
@group(0) @binding(0) var glass: texture_2d<f32>;

@vertex
fn whole(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    let corner = vec2(f32((i << 1u) & 2u), f32(i & 2u));
    return vec4(corner * 2.0 - 1.0, 0.0, 1.0);
}

@fragment
fn lay(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    return textureLoad(glass, vec2<i32>(at.xy), 0);
}
