//! A track: the two ruts that the wheels of a rover have pressed into the soil.
//!
//! Must not know: the rover, the rest of the relief.

use glam::Vec2;

use super::noise::{gradient_noise_2d, smoothstep};
use crate::rounding::floor_and_fraction;

/// Half the width, in half widths of a rut, over which its walls fall from the ground to the floor; where a mesh is coarse, this many of
/// its cells instead.
const WALL: f32 = 0.16;
/// See [`WALL`].
const WALL_CELLS: f32 = 0.6;
/// The share of a rut in a mesh falls from 1 to 0 between cells of this many of its widths and of twice as many.
const COARSEST: f32 = 0.8;
/// Width of the soil pushed up on both sides, in half widths of a rut, and its height relative to the depth: most of the soil is
/// compacted instead.
const BERM: [f32; 2] = [0.7, 0.2];
/// Imprints of the grousers around a wheel; Yutu's wheels have 24 grousers.
const IMPRINTS_PER_TURN: f32 = 24.0;
/// Mean of the profile of an imprint over its period.
const MEAN_IMPRINT: f32 = 0.25;
/// How the depth varies along a rut: wavelength, metres, and amplitude relative to the depth.
const UNEVEN: (f32, f32) = (0.4, 0.5);
/// How ragged the walls are: wavelength, metres, and amplitude in half widths of a rut.
const RAGGED: (f32, f32) = (0.03, 0.12);
/// Length over which a track ends, metres.
const END_M: f32 = 0.1;

/// A track along an arc of a circle, or a straight line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// A point on its middle line, metres from the centre of the ground.
    pub offset: Vec2,
    /// Unit vector along the middle line there.
    pub ahead: Vec2,
    /// Curvature, positive to the left, per metre.
    pub curvature_per_m: f32,
    /// Where it begins and ends along the middle line, metres from `offset`.
    pub span_m: [f32; 2],
    /// Distance of the middles of the two ruts, metres.
    pub gauge_m: f32,
    /// Width of a rut, metres.
    pub width_m: f32,
    /// Depth of a rut, metres.
    pub depth_m: f32,
    /// Depth of the imprints of the grousers below the floor of a rut, metres.
    pub grouser_m: f32,
    /// Diameter of a wheel, metres.
    pub wheel_m: f32,
    /// Seed of its irregularities.
    pub seed: u32,
}

impl Track {
    /// Position along and across the middle line, metres; across is positive to the left. Distances across are exact: the middle line is
    /// a circle through `offset`, in a form that holds for a straight line too.
    #[inline(always)]
    fn along_and_across(&self, point: Vec2) -> [f32; 2] {
        let from = point - self.offset;
        let (x, y, k) = (self.ahead.dot(from), self.ahead.perp_dot(from), self.curvature_per_m);
        let squared = (1.0 - 2.0 * k * y + k * k * (x * x + y * y)).max(0.0);
        let across_m = (2.0 * y - k * (x * x + y * y)) / (1.0 + squared.sqrt());
        let along_m = if k == 0.0 { x } else { libm::atan2f(k * x, 1.0 - k * y) / k };
        [along_m, across_m]
    }

    /// Distance across, from the middle line, within which it changes the height, metres.
    fn reach_m(&self) -> f32 {
        let widest_wall = 4.0 * COARSEST * WALL_CELLS;
        0.5 * self.gauge_m + 0.5 * self.width_m * (1.0 + RAGGED.1 + BERM[0].max(widest_wall))
    }

    /// Whether it may change the height somewhere in a circle, metres from the centre of the ground.
    #[must_use]
    pub fn is_near(&self, centre: Vec2, radius_m: f32) -> bool {
        let [along_m, across_m] = self.along_and_across(centre);
        // Along the line a circle spans more than its radius where it is closer to the middle of the bend.
        let bend = (1.0 - self.curvature_per_m * across_m).max(0.25);
        let beyond_m = (self.span_m[0] - along_m).max(along_m - self.span_m[1]);
        across_m.abs() <= radius_m + self.reach_m() && beyond_m * bend <= radius_m
    }

    /// Whether a wheel went over a circle, metres from the centre of the ground.
    #[must_use]
    pub fn runs_over(&self, centre: Vec2, radius_m: f32) -> bool {
        let [along_m, across_m] = self.along_and_across(centre);
        let beyond_m = radius_m + 0.5 * self.wheel_m;
        let is_along = along_m >= self.span_m[0] - beyond_m && along_m <= self.span_m[1] + beyond_m;
        is_along && (across_m.abs() - 0.5 * self.gauge_m).abs() <= 0.5 * self.width_m + radius_m
    }

    /// Adds its height at points (structure of arrays, metres from the centre of the ground) for a mesh through them with cells of this
    /// size, metres. `in_mesh` is the fraction of a feature of some size, metres, that this mesh has.
    pub(super) fn add_heights(
        &self,
        [x, y]: [&[f32]; 2],
        cell_m: f32,
        in_mesh: impl Fn(f32) -> f32,
        heights: &mut [f32],
    ) {
        let cells = cell_m / self.width_m;
        let share = (2.0 - cells / COARSEST).clamp(0.0, 1.0);
        if share == 0.0 {
            return;
        }
        let period_m = std::f32::consts::PI * self.wheel_m / IMPRINTS_PER_TURN;
        let in_mesh = InMesh {
            wall: WALL.max(2.0 * WALL_CELLS * cells),
            imprints: in_mesh(1.5 * period_m),
            ragged: in_mesh(RAGGED.0),
            period_m,
        };
        for ((height, x), y) in heights.iter_mut().zip(x).zip(y) {
            *height += share * self.height_at(Vec2::new(*x, *y), &in_mesh);
        }
    }

    fn height_at(&self, point: Vec2, in_mesh: &InMesh) -> f32 {
        let [along_m, across_m] = self.along_and_across(point);
        let inside_m = (along_m - self.span_m[0]).min(self.span_m[1] - along_m);
        if across_m.abs() > self.reach_m() || inside_m <= 0.0 {
            return 0.0;
        }
        let rut = u32::from(across_m > 0.0);
        let noise = |wavelength_m: f32, salt: u32| {
            let (column, u) = floor_and_fraction(along_m / wavelength_m);
            gradient_noise_2d([column, rut as i32], [u, 0.5], self.seed ^ salt)
        };
        let ragged = in_mesh.ragged * RAGGED.1 * noise(RAGGED.0, 1);
        // Distance from the middle of the rut, in half widths.
        let from_middle = (across_m.abs() - 0.5 * self.gauge_m).abs() / (0.5 * self.width_m) + ragged;
        let floor = 1.0 - smoothstep(((from_middle - 1.0) / (2.0 * in_mesh.wall) + 0.5).clamp(0.0, 1.0));
        let berm = {
            let t = ((from_middle - 1.0) / BERM[0]).clamp(0.0, 1.0);
            let bump = 4.0 * t * (1.0 - t);
            BERM[1] * bump * bump
        };
        let depth_m =
            self.depth_m * (1.0 + UNEVEN.1 * noise(UNEVEN.0, 2)) * smoothstep((inside_m / END_M).min(1.0));
        // The imprint of a grouser is narrower than the soil between two of them. The two wheels are not in step.
        let (_, turn) = floor_and_fraction(along_m / in_mesh.period_m + 0.37 * rut as f32);
        let tooth = 1.0 - (2.0 * turn - 1.0).abs();
        let imprint = MEAN_IMPRINT + in_mesh.imprints * (tooth * tooth * tooth - MEAN_IMPRINT);
        let grouser_m = self.grouser_m.min(depth_m);
        depth_m * (berm - floor) - grouser_m * imprint * floor
    }
}

/// What a mesh has of the details of a track: the half width of its walls, in half widths of a rut; fractions of the imprints and of the
/// raggedness. And the period of the imprints, metres.
struct InMesh {
    wall: f32,
    imprints: f32,
    ragged: f32,
    period_m: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRACK: Track = Track {
        offset: Vec2::new(1.0, 2.0),
        ahead: Vec2::new(0.6, 0.8),
        curvature_per_m: 0.0,
        span_m: [-5.0, 5.0],
        gauge_m: 1.0,
        width_m: 0.2,
        depth_m: 0.02,
        grouser_m: 0.005,
        wheel_m: 0.3,
        seed: 7,
    };

    #[test]
    fn positions_on_an_arc_are_those_of_its_circle() {
        for curvature_per_m in [-0.4_f32, -1e-4, 0.0, 1e-6, 0.25] {
            let track = Track { curvature_per_m, ..TRACK };
            for (along_m, across_m) in [(0.0, 0.0), (2.0, 0.5), (-3.0, -1.0), (0.3, 1.5)] {
                // Walk along the arc in small steps.
                let (mut point, mut ahead) = (track.offset.as_dvec2(), track.ahead.as_dvec2());
                let steps = 20_000;
                let turn = glam::DVec2::from_angle(f64::from(curvature_per_m * along_m) / f64::from(steps));
                for _ in 0..steps {
                    point += f64::from(along_m) / f64::from(steps) * ahead;
                    ahead = turn.rotate(ahead);
                }
                let at = (point + f64::from(across_m) * ahead.perp()).as_vec2();
                let [found_along_m, found_across_m] = track.along_and_across(at);
                assert!(
                    (found_along_m - along_m).abs() < 1e-3,
                    "{curvature_per_m}: {found_along_m}, {along_m}"
                );
                assert!(
                    (found_across_m - across_m).abs() < 1e-3,
                    "{curvature_per_m}: {found_across_m}, {across_m}"
                );
            }
        }
    }

    #[test]
    fn ruts_are_as_deep_and_wide_as_said_and_berms_rise_beside_them() {
        let height = |across_m: f32, along_m: f32| {
            let mut height = [0.0];
            let at = TRACK.offset + along_m * TRACK.ahead + across_m * TRACK.ahead.perp();
            TRACK.add_heights([&[at.x], &[at.y]], 0.0, |_| 1.0, &mut height);
            height[0]
        };
        let mean = |across_m: f32| {
            (0..2000).map(|k| height(across_m, -4.0 + 0.004 * k as f32)).sum::<f32>() / 2000.0
        };
        for side in [-0.5, 0.5] {
            let floor_m = mean(side);
            assert!((floor_m + 0.02 + 0.005 * MEAN_IMPRINT).abs() < 0.002, "floor at {floor_m}");
            for wall in [-0.1, 0.1] {
                assert!((mean(side + wall) / floor_m - 0.5).abs() < 0.15, "wall at {}", mean(side + wall));
            }
            assert!(mean(side + 0.135) > 0.002 && mean(side - 0.135) > 0.002, "no berms");
        }
        assert_eq!(height(0.0, 0.0), 0.0);
        assert_eq!(height(0.5, 5.1), 0.0);
        // Grousers press at even distances.
        let along: Vec<f32> = (0..4000).map(|k| height(0.5, 0.0005 * k as f32)).collect();
        let lows = along.windows(3).filter(|w| w[1] < w[0] && w[1] <= w[2]).count();
        assert!(
            (lows as f32 - 2.0 / (std::f32::consts::PI * 0.3 / 24.0)).abs() < 3.0,
            "{lows} imprints in 2 m"
        );
    }

    #[test]
    fn nothing_changes_where_a_track_is_not_near() {
        for curvature_per_m in [-0.3, 0.0, 0.3] {
            let track = Track { curvature_per_m, ..TRACK };
            for k in 0..4000 {
                let [u, v] = [k * 7919 % 1999, k * 104_729 % 2003].map(|k| k as f32 / 100.0 - 10.0);
                let mut height = [0.0];
                track.add_heights([&[u], &[v]], 0.0, |_| 1.0, &mut height);
                assert!(height[0] == 0.0 || track.is_near(Vec2::new(u, v), 0.0), "{u}, {v}");
                if !track.is_near(Vec2::new(u, v), 0.5) {
                    let mut heights = [0.0; 4];
                    let x = [u + 0.35, u - 0.35, u + 0.35, u - 0.35];
                    let y = [v + 0.35, v - 0.35, v - 0.35, v + 0.35];
                    track.add_heights([&x, &y], 0.0, |_| 1.0, &mut heights);
                    assert_eq!(heights, [0.0; 4], "within 0.5 m of {u}, {v}");
                }
            }
        }
    }
}
