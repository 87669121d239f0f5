//! The footprint of the view: the region of the map that holds everything the image can show.
//!
//! Horizon map and caster grid are computed for it alone.
//! Must not know: buffers.

use glam::{DMat3, DVec3, DVec4, Vec2, Vec3};

use crate::render::raster::clip::clip_polygon;
use crate::render::select::selection::Selection;
use crate::scene::Scene;

/// A convex polygon on the map, as seen from above.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Footprint {
    /// Counterclockwise, metres, world.
    pub corners: Vec<Vec2>,
}

impl Footprint {
    /// The footprint of all ground and rocks that a selection draws: the part of the frustum between the lowest and the highest of
    /// them, projected onto the map.
    #[must_use]
    pub fn new(scene: &Scene, selection: &Selection) -> Self {
        let terrain = &scene.terrain;
        let [mut lowest_m, mut highest_m] = terrain.z_range_m;
        // Rocks may overhang the border of the ground.
        let mut widest_m = 0.0_f32;
        for rock in selection.rocks.iter().map(|selected| &scene.rocks[selected.rock]) {
            lowest_m = lowest_m.min(rock.centre.z - rock.radius_m);
            highest_m = highest_m.max(rock.centre.z + rock.radius_m);
            widest_m = widest_m.max(rock.radius_m);
        }
        let (centre, reach_m) = (terrain.centre, terrain.half_extent_m + widest_m);
        let side = |normal: DVec3, offset_m: f32| normal.extend(f64::from(offset_m));
        let planes: Vec<DVec4> = [
            side(DVec3::Z, -lowest_m),
            side(DVec3::NEG_Z, highest_m),
            side(DVec3::X, reach_m - centre.x),
            side(DVec3::NEG_X, reach_m + centre.x),
            side(DVec3::Y, reach_m - centre.y),
            side(DVec3::NEG_Y, reach_m + centre.y),
        ]
        .into_iter()
        .chain(selection.frustum.planes().map(|plane| plane.as_dvec4()))
        .collect();
        Self::hull(polytope_corners(&planes).map(|corner| corner.truncate().as_vec2()))
    }

    /// The convex hull of points, by the monotone chain of Andrew 1979 ("Another efficient algorithm for convex hulls in two
    /// dimensions", Information Processing Letters 9).
    pub fn hull(points: impl Iterator<Item = Vec2>) -> Self {
        let mut points: Vec<Vec2> = points.collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        points.dedup();
        let half_hull = |points: &mut dyn Iterator<Item = Vec2>| {
            let mut chain: Vec<Vec2> = Vec::new();
            for point in points {
                while let [.., a, b] = chain[..]
                    && (b - a).perp_dot(point - a) <= 0.0
                {
                    chain.pop();
                }
                chain.push(point);
            }
            // The last point is the first of the other half.
            if chain.len() > 1 {
                chain.pop();
            }
            chain
        };
        let mut corners = half_hull(&mut points.iter().copied());
        if points.len() > 1 {
            corners.extend(half_hull(&mut points.iter().rev().copied()));
        }
        Self { corners }
    }

    /// Its sides: a point is inside where `x` and `y` of each, times its coordinates, and `z` add up to no less than zero.
    #[must_use]
    pub fn sides(&self) -> Vec<Vec3> {
        let next = self.corners.iter().cycle().skip(1);
        let side = |(from, to): (&Vec2, &Vec2)| {
            let inward = (*to - *from).perp();
            inward.extend(-inward.dot(*from))
        };
        self.corners.iter().zip(next).map(side).collect()
    }

    /// The same polygon in other coordinates.
    #[must_use]
    pub fn mapped(&self, map: impl Fn(Vec2) -> Vec2) -> Self {
        Self { corners: self.corners.iter().map(|&corner| map(corner)).collect() }
    }

    /// Minimum and maximum x of the part between two y; `None` if there is no such part.
    #[must_use]
    pub fn span(&self, south: f32, north: f32) -> Option<[f32; 2]> {
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for (from, to) in self.corners.iter().zip(self.corners.iter().cycle().skip(1)) {
            let rise = to.y - from.y;
            let parameter = |y: f32| if rise == 0.0 { 0.0 } else { ((y - from.y) / rise).clamp(0.0, 1.0) };
            // The part of the edge between the two; of an edge along x all or nothing.
            let reaches = from.y.min(to.y) <= north && from.y.max(to.y) >= south;
            let ends = if rise == 0.0 { [0.0, 1.0] } else { [parameter(south), parameter(north)] };
            for x in ends.map(|t| from.x + (to.x - from.x) * t).into_iter().filter(|_| reaches) {
                (low, high) = (low.min(x), high.max(x));
            }
        }
        (low <= high).then_some([low, high])
    }

    /// The part within a square around a place.
    #[must_use]
    pub fn within(&self, centre: Vec2, half_m: f32) -> Self {
        let interpolate = |inner: &Vec2, outer: &Vec2, t: f32| *inner + (*outer - *inner) * t;
        let sides = [Vec2::X, Vec2::NEG_X, Vec2::Y, Vec2::NEG_Y];
        let corners = sides.iter().fold(self.corners.clone(), |corners, normal| {
            clip_polygon(&corners, |corner| half_m - (*corner - centre).dot(*normal), interpolate)
        });
        Self { corners }
    }
}

/// The corners of the polytope that planes bound (normals inward, distance in w): where three planes meet on the inner side of all
/// others.
fn polytope_corners(planes: &[DVec4]) -> impl Iterator<Item = DVec3> {
    let count = planes.len();
    let triples = (0..count).flat_map(move |a| (0..a).flat_map(move |b| (0..b).map(move |c| [a, b, c])));
    triples.filter_map(move |triple| {
        let [a, b, c] = triple.map(|plane| planes[plane]);
        let normals = DMat3::from_cols(a.truncate(), b.truncate(), c.truncate()).transpose();
        if normals.determinant().abs() < 1e-9 {
            return None;
        }
        let corner = -(normals.inverse() * DVec3::new(a.w, b.w, c.w));
        let slack_m = 1e-4 + 1e-6 * corner.length();
        planes.iter().all(|plane| plane.dot(corner.extend(1.0)) >= -slack_m).then_some(corner)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hull_is_clipped_to_a_square_and_has_spans() {
        let points = [(0.0, 0.0), (4.0, 0.0), (2.0, 1.0), (4.0, 4.0), (0.0, 4.0), (2.0, 0.0), (0.0, 0.0)];
        let hull = Footprint::hull(points.iter().map(|&(x, y)| Vec2::new(x, y)));
        let square = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)].map(|(x, y)| Vec2::new(x, y));
        assert_eq!(hull.corners, square);
        let part = hull.within(Vec2::new(4.0, 4.0), 1.0);
        assert_eq!(Footprint::hull(part.corners.into_iter()).corners.len(), 4);
        assert!(hull.within(Vec2::splat(9.0), 1.0).corners.is_empty());
        let triangle =
            Footprint::hull([(0.0, 0.0), (4.0, 0.0), (0.0, 4.0)].iter().map(|&(x, y)| Vec2::new(x, y)));
        assert_eq!(triangle.span(1.0, 2.0), Some([0.0, 3.0]));
        assert_eq!(triangle.span(-1.0, 0.0), Some([0.0, 4.0]));
        assert_eq!(triangle.span(-1.0, 9.0), Some([0.0, 4.0]));
        assert_eq!(triangle.span(4.5, 9.0), None);
        let is_inside =
            |x: f32, y: f32| triangle.sides().iter().all(|side| side.dot(Vec3::new(x, y, 1.0)) >= 0.0);
        assert!(is_inside(1.0, 1.0) && is_inside(0.0, 0.0) && is_inside(3.9, 0.05));
        assert!(!is_inside(-0.1, 1.0) && !is_inside(2.1, 2.0) && !is_inside(1.0, -0.1));
    }

    #[test]
    fn plane_cuts_a_corner_off_a_cube() {
        let mut planes: Vec<DVec4> = [DVec3::X, DVec3::Y, DVec3::Z]
            .into_iter()
            .flat_map(|axis| [axis.extend(1.0), (-axis).extend(1.0)])
            .collect();
        assert_eq!(polytope_corners(&planes).count(), 8);
        // One corner less, and a triangle in its place.
        planes.push(DVec4::new(-1.0, -1.0, -1.0, 2.0));
        assert_eq!(polytope_corners(&planes).count(), 10);
    }
}
