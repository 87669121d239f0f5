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

/// Steps by which devices invert the distortion (`common/lens.wgsl`), from the distorted point on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InverseSteps {
    /// Of the fixed-point iteration, first. They lead to the root that [`Lens::undistort`] finds where Newton's method alone would not.
    pub fixed_point: u32,
    /// Of Newton's method.
    pub newton: u32,
}

impl InverseSteps {
    /// Both numbers in one word, as uniforms have them.
    #[must_use]
    pub const fn packed(self) -> u32 {
        self.fixed_point << 16 | self.newton
    }
}

/// Fixed-point iterations of the inverse.
const STEPS: u32 = 24;
/// Numbers of them before Newton's method, of which the first that serves is taken: 0 for most lenses.
const FIXED_POINT_STEPS: [u32; 4] = [0, 4, 12, STEPS];
/// Largest residual of the inverse by Newton's method, in units of the focal length: below 1e-5 samples of a wide image.
const MAX_RESIDUAL: f64 = 3e-9;
/// Largest residual of the fixed-point iteration, likewise.
const MAX_FIXED_POINT_RESIDUAL: f64 = 1e-6;
/// Minimum determinant of the derivatives where Newton's method begins: near 0 its step leads to another root.
const MIN_DETERMINANT: f64 = 0.1;
/// Largest part of its error that a step of the fixed-point iteration leaves: from anywhere it converges only where it does at the root.
const MAX_RATE: f64 = 0.75;
/// Minimum radial factor of its iterates: where the factor nears 0 the next one is anywhere.
const MIN_RADIAL: f64 = 0.25;

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
        self.iterated(distorted, STEPS).0
    }

    /// A distorted point after some steps of the fixed-point iteration, and the smallest radial factor on its way.
    fn iterated(&self, distorted: [f64; 2], steps: u32) -> ([f64; 2], f64) {
        let (mut point, mut min_radial) = (distorted, f64::INFINITY);
        for _ in 0..steps {
            let (radial, [dx, dy]) = self.terms(point);
            point = [(distorted[0] - dx) / radial, (distorted[1] - dy) / radial];
            min_radial = min_radial.min(radial);
        }
        (point, min_radial)
    }

    /// Steps that map every point of a distorted image with half extents `half` to the undistorted one, the same as [`Self::undistort`].
    /// They are counted on a grid over the image and on its diagonals: 2 or 3 of Newton's method for most lenses. `None` if the mapping
    /// folds within the image or is too strong for the inverse to converge.
    #[must_use]
    pub fn inverse_steps(&self, half: [f64; 2]) -> Option<InverseSteps> {
        if self.is_pinhole() {
            return Some(InverseSteps { fixed_point: 0, newton: 0 });
        }
        let along = |step: i32, of: i32| f64::from(step) / f64::from(of);
        let grid = (-8..=8).flat_map(|row| (-8..=8).map(move |column| [along(column, 8), along(row, 8)]));
        let diagonals =
            (-64..=64).flat_map(|step| [1.0, -1.0].map(|side| [along(step, 64), side * along(step, 64)]));
        let points = grid.chain(diagonals).map(|at| [at[0] * half[0], at[1] * half[1]]);
        let pairs: Vec<_> = points
            .map(|distorted| Some((distorted, self.checked_inverse(distorted)?)))
            .collect::<Option<_>>()?;
        FIXED_POINT_STEPS.into_iter().find_map(|fixed_point| {
            let steps = pairs.iter().map(|pair| self.newton_steps(*pair, fixed_point));
            let newton = steps.reduce(|most, steps| Some(most?.max(steps?))).flatten()?;
            Some(InverseSteps { fixed_point, newton })
        })
    }

    /// As [`Self::undistort`]; `None` if the iteration does not converge, or runs astray on its way, so that neighbours of the point may
    /// lead elsewhere.
    fn checked_inverse(&self, distorted: [f64; 2]) -> Option<[f64; 2]> {
        let (point, min_radial) = self.iterated(distorted, STEPS);
        let back = self.distort(point);
        let residual = (back[0] - distorted[0]).abs().max((back[1] - distorted[1]).abs());
        let square = point[0] * point[0] + point[1] * point[1];
        let rate = (square * self.slope(square)).abs() / self.terms(point).0;
        let is_found = residual <= MAX_FIXED_POINT_RESIDUAL && rate <= MAX_RATE && min_radial >= MIN_RADIAL;
        is_found.then_some(point)
    }

    /// Steps of Newton's method after some of the fixed-point iteration; `None` if they do not lead from a distorted point to its
    /// undistorted one.
    fn newton_steps(&self, (distorted, undistorted): ([f64; 2], [f64; 2]), fixed_point: u32) -> Option<u32> {
        let (mut point, _) = self.iterated(distorted, fixed_point);
        for steps in 0..STEPS {
            let back = self.distort(point);
            let residual = [back[0] - distorted[0], back[1] - distorted[1]];
            if residual[0].abs().max(residual[1].abs()) <= MAX_RESIDUAL {
                let off = (point[0] - undistorted[0]).abs().max((point[1] - undistorted[1]).abs());
                return (off <= 10.0 * MAX_FIXED_POINT_RESIDUAL).then_some(steps);
            }
            let [a, b, c] = self.jacobian(point);
            let determinant = a * c - b * b;
            if steps == 0 && fixed_point < STEPS && (determinant < MIN_DETERMINANT || a + c <= 0.0) {
                return None;
            }
            point[0] -= (c * residual[0] - b * residual[1]) / determinant;
            point[1] -= (a * residual[1] - b * residual[0]) / determinant;
        }
        None
    }

    /// Derivatives of the distorted point: of x by x, of x by y (and y by x, which is equal), of y by y.
    fn jacobian(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let square = x * x + y * y;
        let radial = 1.0 + square * (self.k1 + square * (self.k2 + square * self.k3));
        let slope = self.slope(square);
        [
            radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            slope * x * y + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
            radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        ]
    }

    /// Derivative of the radial factor, over the radius, at a squared radius.
    fn slope(&self, square: f64) -> f64 {
        2.0 * (self.k1 + square * (2.0 * self.k2 + square * 3.0 * self.k3))
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
        self.inverse_steps(half)?;
        let mut reach = [1.0_f64; 2];
        for step in -16..=16 {
            let along = f64::from(step) / 16.0;
            for at in [[along, -1.0], [along, 1.0], [-1.0, along], [1.0, along]] {
                let at = [at[0] * half[0], at[1] * half[1]];
                let point = self.checked_inverse(at)?;
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
        let newton = |lens: Lens, half| {
            let InverseSteps { fixed_point, newton } = lens.inverse_steps(half).expect("a lens");
            assert_eq!(fixed_point, 0, "{lens:?}");
            newton
        };
        assert!((2..=3).contains(&newton(Lens { k1: -0.08, ..Lens::default() }, [0.77, 0.77])));
        assert!(newton(LENS, [0.6, 0.5]) <= 4);
        assert_eq!(newton(Lens::default(), [0.6, 0.5]), 0);
    }

    /// From the distorted point alone Newton's method leads to another root in the corners.
    #[test]
    fn lenses_that_turn_beyond_the_corner_take_other_steps_first() {
        let lens = Lens { k1: 0.232, k2: 0.267, k3: -0.214, ..Lens::default() };
        let half = libm::tan(0.5 * 82.7_f64.to_radians());
        assert!(lens.inverse_steps([half; 2]).expect("a lens").fixed_point > 0);
        // Near the corner the fixed-point iteration runs astray.
        let lens = Lens { k1: 0.011, k2: 0.33, k3: -0.142, ..Lens::default() };
        let half = libm::tan(0.5 * 97.1_f64.to_radians());
        assert_eq!(lens.reach([half; 2]), None);
        // It finds the corner only after its radial factor was negative.
        let lens = Lens { k1: 0.589, k2: -0.153, k3: -0.197, ..Lens::default() };
        let half = libm::tan(0.5 * 80.5_f64.to_radians());
        assert_eq!(lens.reach([half; 2]), None);
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
