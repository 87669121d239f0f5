// Directions as two numbers: the sphere laid out as an octahedron, and that as a square (Meyer et al. 2010, "On
// Floating-Point Normal Vectors").

// A vector's direction: a driver that runs on the CPU makes a division of its own for each part of `normalize`.
fn unit(v: vec3<f32>) -> vec3<f32> {
    return v * inverseSqrt(dot(v, v));
}

// From a vector of any length but 0.
fn octahedral_encode(v: vec3<f32>) -> vec2<f32> {
    let p = v.xy / max(abs(v.x) + abs(v.y) + abs(v.z), 1.0e-30);
    return select(p, (1.0 - abs(p.yx)) * select(vec2(-1.0), vec2(1.0), p >= vec2(0.0)), v.z < 0.0);
}

// The unit vector.
fn octahedral_decode(p: vec2<f32>) -> vec3<f32> {
    let z = 1.0 - abs(p.x) - abs(p.y);
    let back = max(-z, 0.0);
    return unit(vec3(p - select(vec2(-back), vec2(back), p >= vec2(0.0)), z));
}
