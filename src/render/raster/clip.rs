//! Polygon clipping.
//!
//! Must not know: what a vertex carries, which plane it clips at.

/// The part of a convex polygon where `distance` is not negative (Sutherland and Hodgman 1974, "Reentrant polygon clipping").
///
/// An edge that two polygons share is cut at the same point in both, whichever way each runs along it: `interpolate` gets the
/// inner vertex, the outer one, and how far the new vertex is from the first to the second (0 to 1).
#[must_use]
pub(crate) fn clip_polygon<T: Copy>(
    polygon: &[T],
    distance: impl Fn(&T) -> f32,
    interpolate: impl Fn(&T, &T, f32) -> T,
) -> Vec<T> {
    let mut clipped = Vec::with_capacity(polygon.len() + 1);
    for (i, from) in polygon.iter().enumerate() {
        let to = &polygon[(i + 1) % polygon.len()];
        let (from_distance, to_distance) = (distance(from), distance(to));
        if from_distance >= 0.0 {
            clipped.push(*from);
        }
        if (from_distance >= 0.0) != (to_distance >= 0.0) {
            clipped.push(if from_distance >= 0.0 {
                interpolate(from, to, from_distance / (from_distance - to_distance))
            } else {
                interpolate(to, from, to_distance / (to_distance - from_distance))
            });
        }
    }
    clipped
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    fn mix(a: &Vec2, b: &Vec2, t: f32) -> Vec2 {
        *a + t * (*b - *a)
    }

    #[test]
    fn a_square_loses_the_corner_beyond_the_plane() {
        let square = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        let clipped = clip_polygon(&square, |p| 1.5 - p.x - p.y, mix);
        assert_eq!(clipped, [Vec2::ZERO, Vec2::X, Vec2::new(1.0, 0.5), Vec2::new(0.5, 1.0), Vec2::Y]);
        assert_eq!(clip_polygon(&square, |p| 1.0 - p.x, mix), square, "a vertex on the plane stays");
        assert!(clip_polygon(&square, |p| p.x - 2.0, mix).is_empty());
        assert!(clip_polygon(&[], |p: &Vec2| p.x, mix).is_empty());
    }

    #[test]
    fn polygons_that_share_an_edge_are_cut_at_the_same_point() {
        let (a, b) = (Vec2::new(0.1, 0.3), Vec2::new(0.7, -0.9));
        let distance = |p: &Vec2| 0.377 * p.x + p.y + 0.123;
        let cut_vertices = |third: Vec2, edge: [Vec2; 2]| {
            let clipped = clip_polygon(&[edge[0], edge[1], third], distance, mix);
            clipped.into_iter().filter(|p| distance(p).abs() < 1e-5).collect::<Vec<_>>()
        };
        let left = cut_vertices(Vec2::new(0.0, 1.0), [a, b]);
        let right = cut_vertices(Vec2::new(2.0, 1.0), [b, a]);
        assert_eq!(left.iter().filter(|p| right.contains(p)).count(), 1, "{left:?} and {right:?}");
    }
}
