//! Lens distortion.
//!
//! The Brown-Conrady model (Brown 1966, "Decentering Distortion of Lenses") in the form and with the names of OpenCV, on
//! normalised image coordinates: relative to the principal point, divided by the focal length, x right and y down.
//! Must not know: what is imaged.

/// Distortion coefficients; all 0 is a pinhole camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lens {
    /// Radial, of the squared radius; negative for barrel distortion.
    pub k1: f64,
    /// Radial, of the fourth power of the radius.
    pub k2: f64,
    /// Radial, of the sixth power of the radius.
    pub k3: f64,
    /// Tangential (decentering), vertical.
    pub p1: f64,
    /// Tangential (decentering), horizontal.
    pub p2: f64,
}

/// Fixed-point iterations of the inverse.
const STEPS: u32 = 24;
/// Largest residual of the inverse by Newton's method, in units of the focal length: below 1e-5 samples of a wide image.
const MAX_RESIDUAL: f64 = 3e-9;

impl Lens {
    /// Whether it distorts at all.
    #[must_use]
    pub fn is_pinhole(&self) -> bool {
        *self == Self::default()
    }

    /// Maps a point of the undistorted image to the distorted one.
    #[must_use]
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (radial, [dx, dy]) = self.terms([x, y]);
        [x * radial + dx, y * radial + dy]
    }

    /// Maps a point of the distorted image to the undistorted one, by fixed-point iteration.
    #[must_use]
    pub fn undistort(&self, distorted: [f64; 2]) -> [f64; 2] {
        let mut point = distorted;
        for _ in 0..STEPS {
            let (radial, [dx, dy]) = self.terms(point);
            point = [(distorted[0] - dx) / radial, (distorted[1] - dy) / radial];
        }
        point
    }

    /// Steps of Newton's method that map every point of a distorted image with half extents `half` to the undistorted one, from the
    /// distorted point on (`common/lens.wgsl` takes them). They are counted on a grid over the image: 2 or 3 for most lenses, and no
    /// more than the fixed-point iteration takes where they do not converge.
    #[must_use]
    pub fn newton_steps(&self, half: [f64; 2]) -> u32 {
        let along = |step: i32| f64::from(step) / 8.0;
        let grid = (-8..=8).flat_map(|row| (-8..=8).map(move |column| [along(column), along(row)]));
        let points = grid.map(|at| [at[0] * half[0], at[1] * half[1]]);
        points.map(|distorted| self.newton_steps_of(distorted)).max().unwrap_or(0)
    }

    fn newton_steps_of(&self, distorted: [f64; 2]) -> u32 {
        let mut point = distorted;
        for steps in 0..STEPS {
            let back = self.distort(point);
            let residual = [back[0] - distorted[0], back[1] - distorted[1]];
            if residual[0].abs().max(residual[1].abs()) <= MAX_RESIDUAL {
                return steps;
            }
            let [a, b, c] = self.jacobian(point);
            let determinant = a * c - b * b;
            point[0] -= (c * residual[0] - b * residual[1]) / determinant;
            point[1] -= (a * residual[1] - b * residual[0]) / determinant;
        }
        STEPS
    }

    /// Derivatives of the distorted point: of x by x, of x by y (and y by x, which is equal), of y by y.
    fn jacobian(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let square = x * x + y * y;
        let radial = 1.0 + square * (self.k1 + square * (self.k2 + square * self.k3));
        let slope = 2.0 * (self.k1 + square * (2.0 * self.k2 + square * 3.0 * self.k3));
        [
            radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            slope * x * y + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
            radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        ]
    }

    /// Radial factor and tangential shift.
    fn terms(&self, [x, y]: [f64; 2]) -> (f64, [f64; 2]) {
        let square = x * x + y * y;
        let radial = 1.0 + square * (self.k1 + square * (self.k2 + square * self.k3));
        let shift = [
            2.0 * self.p1 * x * y + self.p2 * (square + 2.0 * x * x),
            self.p1 * (square + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        ];
        (radial, shift)
    }

    /// Half extents of the undistorted image that cover a distorted image with half extents `half`, as multiples of these;
    /// `None` if the mapping folds within it or is too strong for the inverse to converge.
    #[must_use]
    pub fn reach(&self, half: [f64; 2]) -> Option<[f64; 2]> {
        let mut reach = [1.0_f64; 2];
        for step in -16..=16 {
            let along = f64::from(step) / 16.0;
            for at in [[along, -1.0], [along, 1.0], [-1.0, along], [1.0, along]] {
                let at = [at[0] * half[0], at[1] * half[1]];
                let point = self.undistort(at);
                let back = self.distort(point);
                let error = (back[0] - at[0]).abs().max((back[1] - at[1]).abs());
                if error.is_nan() || error > 1e-6 {
                    return None;
                }
                reach = [0, 1].map(|axis| reach[axis].max(point[axis].abs() / half[axis]));
            }
        }
        (reach[0].max(reach[1]) <= 3.0).then_some(reach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Lens = Lens { k1: -0.25, k2: 0.06, k3: -0.005, p1: 0.002, p2: -0.001 };

    #[test]
    fn undistort_inverts_distort() {
        for i in 0..100 {
            let point = [f64::from(i % 10) * 0.12 - 0.55, f64::from(i / 10) * 0.11 - 0.5];
            let back = LENS.undistort(LENS.distort(point));
            assert!((back[0] - point[0]).abs() < 1e-9 && (back[1] - point[1]).abs() < 1e-9, "{point:?}");
        }
        assert_eq!(Lens::default().distort([0.3, -0.2]), [0.3, -0.2]);
    }

    #[test]
    fn newtons_method_takes_few_steps() {
        let wide = Lens { k1: -0.08, ..Lens::default() };
        assert!((2..=3).contains(&wide.newton_steps([0.77, 0.77])), "{}", wide.newton_steps([0.77, 0.77]));
        assert!(LENS.newton_steps([0.6, 0.5]) <= 4, "{}", LENS.newton_steps([0.6, 0.5]));
        assert_eq!(Lens::default().newton_steps([0.6, 0.5]), 0);
    }

    #[test]
    fn distort_follows_the_formula() {
        let lens = Lens { k1: -0.2, k2: 0.05, p1: 0.01, ..Lens::default() };
        let [x, y] = lens.distort([0.5, 0.25]);
        let square = 0.3125;
        let radial = 1.0 - 0.2 * square + 0.05 * square * square;
        assert!((x - (0.5 * radial + 2.0 * 0.01 * 0.125)).abs() < 1e-12);
        assert!((y - (0.25 * radial + 0.01 * (square + 2.0 * 0.0625))).abs() < 1e-12);
    }

    #[test]
    fn barrel_distortion_reaches_farther_and_folding_is_refused() {
        let reach = Lens { k1: -0.2, ..Lens::default() }.reach([0.6, 0.4]).expect("a lens");
        assert!(reach[0] > 1.05 && reach[1] > 1.02, "{reach:?}");
        assert_eq!(Lens { k1: -2.0, ..Lens::default() }.reach([0.8, 0.8]), None);
        assert_eq!(
            Lens { k1: 0.2, ..Lens::default() }.reach([0.6, 0.4]).map(|r| r[0] <= 1.0 + 1e-9),
            Some(true)
        );
    }
}
