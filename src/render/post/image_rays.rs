//! The rays of an image's pixels, through the lens that distorts it.
//! Must not know: what the rays are for.

use glam::Vec2;

use crate::frame::Frame;
use crate::lens::Lens;

/// Pixels between the points at which rays through a lens that distorts are computed, at most.
const MAX_STEP_PX: usize = 8;
/// Steps along the longer side of an image that has more pixels than that.
const MIN_STEPS: usize = 64;

/// Where rays cross the plane at a distance of 1 from the eye: x right, y down. Computed for every few pixels, and linear between them:
/// exact without distortion, and with it to 0.03 px of an image 512 pixels wide.
#[derive(Clone, Debug)]
pub(super) struct ImageRays {
    /// Columns and rows of the image.
    pub(super) size: [usize; 2],
    focal_px: f64,
    lens: Lens,
    /// Pixels between the knots; the last of a row or column is at the last pixel.
    step_px: usize,
    columns: usize,
    /// None for a lens that does not distort.
    knots: Vec<Vec2>,
}

impl ImageRays {
    /// Of a frame that has its focal length and lens.
    pub(super) fn new(frame: &Frame) -> Self {
        let size @ [width, height] = [frame.width, frame.height].map(|side| side as usize);
        let step_px = (width.max(height) / MIN_STEPS).clamp(1, MAX_STEP_PX);
        let [columns, rows] = size.map(|side| (side - 1).div_ceil(step_px) + 1);
        let mut rays =
            Self { size, focal_px: frame.focal_px, lens: frame.lens, step_px, columns, knots: Vec::new() };
        let of_knot = |knot: usize| {
            let x = (knot % columns * step_px).min(width - 1);
            let y = (knot / columns * step_px).min(height - 1);
            rays.point([x as f64 + 0.5, y as f64 + 0.5])
        };
        if !rays.lens.is_pinhole() {
            rays.knots = (0..rows * columns).map(of_knot).collect();
        }
        rays
    }

    /// Writes the rays of the centres of a row's pixels.
    pub(super) fn row(&self, y: usize, rays: &mut [Vec2]) {
        let [width, height] = self.size;
        if self.lens.is_pinhole() {
            let per_px = (1.0 / self.focal_px) as f32;
            let at = |px: usize, side: usize| (px as i32 as f32 + 0.5 - 0.5 * side as f32) * per_px;
            let down = at(y, height);
            rays.iter_mut().enumerate().for_each(|(x, ray)| *ray = Vec2::new(at(x, width), down));
            return;
        }
        let (above, part) = self.knot_before(y, height);
        let below = (above + 1).min(self.knots.len() / self.columns - 1);
        let knot = |column: usize| {
            let [a, b] = [above, below].map(|row| self.knots[row * self.columns + column]);
            a.lerp(b, part)
        };
        let mut left = knot(0);
        for (column, rays) in rays.chunks_mut(self.step_px).enumerate() {
            let next = (column + 1).min(self.columns - 1);
            let right = knot(next);
            let span_px = (next * self.step_px).min(width - 1) - column * self.step_px;
            let per_px = 1.0 / span_px.max(1) as f32;
            rays.iter_mut()
                .enumerate()
                .for_each(|(x, ray)| *ray = left.lerp(right, x as i32 as f32 * per_px));
            left = right;
        }
    }

    /// The last knot at or before a pixel along an axis, and the part of the way to the next one.
    fn knot_before(&self, px: usize, side: usize) -> (usize, f32) {
        let knot = px / self.step_px;
        let (start, end) = (knot * self.step_px, ((knot + 1) * self.step_px).min(side - 1));
        (knot, if end > start { (px - start) as f32 / (end - start) as f32 } else { 0.0 })
    }

    /// The ray of a position in the image: column and row, pixels.
    pub(super) fn point(&self, position: [f64; 2]) -> Vec2 {
        let [width, height] = self.size.map(|side| 0.5 * side as f64);
        let at = [position[0] - width, position[1] - height].map(|px| px / self.focal_px);
        Vec2::from(self.lens.undistort(at).map(|number| number as f32))
    }

    /// The position in the image, column and row, pixels, of a ray.
    pub(super) fn position(&self, point: Vec2) -> Vec2 {
        let at = self.lens.distort([f64::from(point.x), f64::from(point.y)]);
        let of_axis = |axis: usize| (at[axis] * self.focal_px + 0.5 * self.size[axis] as f64) as f32;
        Vec2::new(of_axis(0), of_axis(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Between knots too, of images of all sizes, and back.
    #[test]
    fn rays_are_those_of_the_lens() {
        for (width, height, k1) in
            [(1, 1, 0.0), (7, 3, 0.1), (64, 48, -0.2), (300, 513, -0.15), (512, 512, 0.25)]
        {
            let frame = Frame {
                width,
                height,
                focal_px: 1.1 * f64::from(width.max(height)),
                lens: Lens { k1, p1: 0.01 * k1, ..Lens::default() },
                ..Frame::default()
            };
            let rays = ImageRays::new(&frame);
            let mut row = vec![Vec2::ZERO; width as usize];
            for y in (0..height).step_by(3).chain([height - 1]) {
                rays.row(y as usize, &mut row);
                for (x, found) in row.iter().enumerate() {
                    let position = [x as f64 + 0.5, f64::from(y) + 0.5];
                    let exact = rays.point(position);
                    let away_px = found.distance(exact) * frame.focal_px as f32;
                    assert!(away_px < 0.05, "{width} x {height}: {away_px} px at {x}, {y}");
                    let back = rays.position(exact);
                    let away_px = back.distance(Vec2::from(position.map(|px| px as f32)));
                    assert!(away_px < 0.01, "{width} x {height}: {away_px} px at {x}, {y}, and back");
                }
            }
        }
    }
}
