// Inverse of the Brown-Conrady distortion (Brown 1966, "Decentering Distortion of Lenses") in units of the focal length, by
// Newton's method, for some lenses after steps of the fixed-point iteration. CPU counterpart: `Lens::undistort` in src/lens.rs.
//
// All is computed as displacements, which are small: a position of some thousand samples plus a displacement is exact to 1e-4 of
// a sample, the same from a position in units of the focal length is not. And all is rounded alike on every device (exact.wgsl): it decides
// which sample a pixel takes its labels from.

// How a lens displaces a point of the undistorted image.
struct Distortion {
    // Radial factor less 1.
    radial: f32,
    // Distorted less undistorted.
    shift: vec2<f32>,
    // Derivatives of the distorted point: of x by x, of x by y (and y by x, which is equal), of y by y.
    jacobian: vec3<f32>,
}

fn distortion_at(point: vec2<f32>) -> Distortion {
    let k = frame.lens_k;
    let p = frame.lens_p;
    let square = exact_dot2(point, point);
    let radial = exact(square * exact(k.x + exact(square * exact(k.y + exact(square * k.z)))));
    let third = exact(exact(square * 3.0) * k.z);
    let slope = 2.0 * exact(k.x + exact(square * exact(2.0 * k.y + third)));
    let product = exact(point.x * point.y);
    let tangential = 2.0 * exact_dot2(point, p.yx);
    // Of the radial term along each axis, and of the tangential one.
    let stretch = exact2(exact2(slope * point) * point);
    let bend = exact2(4.0 * exact2(p.yx * point));
    let common_part = exact(1.0 + radial);
    let diagonal = exact2(exact2(exact2(common_part + stretch) + tangential) + bend);
    let jacobian = vec3(
        diagonal.x,
        exact(exact(slope * product) + 2.0 * exact_dot2(point.yx, p.yx)),
        diagonal.y,
    );
    let squares = exact2(square + exact2(2.0 * exact2(point * point)));
    let shift = exact2(exact2(exact2(radial * point) + exact2(2.0 * exact2(product * p))) + exact2(p.yx * squares));
    return Distortion(radial, shift, jacobian);
}

// The offset that a Jacobian maps to `mapped`.
fn inverse_of(jacobian: vec3<f32>, mapped: vec2<f32>) -> vec2<f32> {
    let determinant = exact(exact(jacobian.x * jacobian.z) - exact(jacobian.y * jacobian.y));
    let numerator = exact2(exact2(jacobian.zx * mapped) - exact2(jacobian.y * mapped.yx));
    return vec2(quotient(numerator.x, determinant), quotient(numerator.y, determinant));
}

// The displacement from a distorted to the undistorted point, one step after `displacement`.
fn newton_step(distorted: vec2<f32>, displacement: vec2<f32>) -> vec2<f32> {
    let lens = distortion_at(exact2(distorted + displacement));
    return exact2(displacement - inverse_of(lens.jacobian, exact2(displacement + lens.shift)));
}

// The same by the fixed-point iteration: the distorted point less the tangential shift, over the radial factor.
fn fixed_point_step(distorted: vec2<f32>, displacement: vec2<f32>) -> vec2<f32> {
    let lens = distortion_at(exact2(distorted + displacement));
    let back = exact2(exact2(lens.radial * displacement) - lens.shift);
    let factor = exact(1.0 + lens.radial);
    return vec2(quotient(back.x, factor), quotient(back.y, factor));
}

// The displacement from a distorted to the undistorted point. The host counts the steps (`Lens::inverse_steps`).
fn undistortion(distorted: vec2<f32>) -> vec2<f32> {
    var displacement = vec2(0.0);
    for (var step = 0u; step < (frame.lens_steps >> 16u); step++) {
        displacement = fixed_point_step(distorted, displacement);
    }
    for (var step = 0u; step < (frame.lens_steps & 0xffffu); step++) {
        displacement = newton_step(distorted, displacement);
    }
    return displacement;
}
