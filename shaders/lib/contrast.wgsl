// Light and guide of local contrast: logarithms of the luminance, and of the depth in near planes.
fn light_of(colour: vec3<f32>) -> f32 {
    return log(max(dot(colour, vec3(0.2126, 0.7152, 0.0722)), 0.001));
}

// depth: reversed; 0 where there is no wall.
fn guide_of(depth: f32) -> f32 {
    return -log(max(depth, 0.0001));
}
