// Inverse of the Brown-Conrady distortion (Brown 1966, "Decentering Distortion of Lenses") in units of the focal length, by
// Newton's method. CPU counterpart: `Lens::undistort` in src/lens.rs.
//
// All is computed as displacements, which are small: a position of some thousand samples plus a displacement is exact to 1e-4 of
// a sample, the same from a position in units of the focal length is not.

// How a lens displaces a point of the undistorted image.
struct Distortion {
    // Distorted less undistorted.
    shift: vec2<f32>,
    // Derivatives of the distorted point: of x by x, of x by y (and y by x, which is equal), of y by y.
    jacobian: vec3<f32>,
}

fn distortion_at(point: vec2<f32>) -> Distortion {
    let square = dot(point, point);
    let radial = square * (frame.lens_k.x + square * (frame.lens_k.y + square * frame.lens_k.z));
    let slope = 2.0 * (frame.lens_k.x + square * (2.0 * frame.lens_k.y + square * 3.0 * frame.lens_k.z));
    let product = point.x * point.y;
    let tangential = 2.0 * dot(point, frame.lens_p.yx);
    let jacobian = vec3(
        1.0 + radial + slope * point.x * point.x + tangential + 4.0 * frame.lens_p.y * point.x,
        slope * product + 2.0 * dot(point.yx, frame.lens_p.yx),
        1.0 + radial + slope * point.y * point.y + tangential + 4.0 * frame.lens_p.x * point.y,
    );
    let shift = radial * point + 2.0 * product * frame.lens_p
        + frame.lens_p.yx * (square + 2.0 * point * point);
    return Distortion(shift, jacobian);
}

// The offset that a Jacobian maps to `mapped`.
fn inverse_of(jacobian: vec3<f32>, mapped: vec2<f32>) -> vec2<f32> {
    let determinant = jacobian.x * jacobian.z - jacobian.y * jacobian.y;
    return (jacobian.zx * mapped - jacobian.y * mapped.yx) / determinant;
}

// The displacement from a distorted to the undistorted point, one step after `displacement`.
fn newton_step(distorted: vec2<f32>, displacement: vec2<f32>) -> vec2<f32> {
    let lens = distortion_at(distorted + displacement);
    return displacement - inverse_of(lens.jacobian, displacement + lens.shift);
}

// The displacement from a distorted to the undistorted point. The host counts the steps (`Lens::newton_steps`).
fn undistortion(distorted: vec2<f32>) -> vec2<f32> {
    var displacement = vec2(0.0);
    for (var step = 0u; step < frame.lens_steps; step++) {
        displacement = newton_step(distorted, displacement);
    }
    return displacement;
}
