// Octahedral encoding of directions: the sphere is projected onto an octahedron, which unfolds to a square (Meyer et al.
// 2010, "On Floating-Point Normal Vectors"; compared with others in Cigolle et al. 2014, "A Survey of Efficient
// Representations for Independent Unit Vectors").

// Maximum code of a coordinate of a normal in the visibility buffer: 24 bits.
const MAX_NORMAL_CODE: f32 = 16777215.0;

// Unit vector of a direction. One inverse square root and no divisions: llvmpipe divides once per component in
// `normalize`.
fn unit(v: vec3<f32>) -> vec3<f32> {
    return v * inverseSqrt(dot(v, v));
}

// Point of the square [-1, 1] x [-1, 1] that stands for the direction of `v`, which need not be a unit vector.
fn octahedral_encode(v: vec3<f32>) -> vec2<f32> {
    let p = v.xy / max(abs(v.x) + abs(v.y) + abs(v.z), 1.0e-30);
    return select(p, (1.0 - abs(p.yx)) * select(vec2(-1.0), vec2(1.0), p >= vec2(0.0)), v.z < 0.0);
}

// Unit vector of a point of the square.
fn octahedral_decode(p: vec2<f32>) -> vec3<f32> {
    let z = 1.0 - abs(p.x) - abs(p.y);
    let fold = max(-z, 0.0);
    return unit(vec3(p - select(vec2(-fold), vec2(fold), p >= vec2(0.0)), z));
}
