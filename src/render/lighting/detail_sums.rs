//! The ground's detail in a batch of samples as it is summed, coarse to fine, where the ray to the eye meets it.
//!
//! All is inlined, to be compiled for each width of vectors.
//! Must not know: what is summed.

use glam::Vec2;

use super::ground_batch::{BATCH, GroundBatch, Vectors};

/// Least clearance of a ray to the eye from the ground that it leaves: how much less the ground rises along it than the ray, relative to
/// the ray. Most ground with less is hidden from the eye, and steps of Newton's method with less miss by more.
pub(crate) const MIN_CLEARANCE: f32 = 0.7;
/// More than any height of relief below the mesh, metres.
pub(crate) const FAR_M: f32 = 1e3;

/// Rise per metre along x and y, the logarithm of the albedo, the height above the mesh, and by how much rays to the sun clear the
/// ground, metres.
pub(super) struct DetailSums {
    pub(super) x: [f32; BATCH],
    pub(super) y: [f32; BATCH],
    pub(super) shade: [f32; BATCH],
    pub(super) height_m: [f32; BATCH],
    pub(super) sun_clearance_m: [f32; BATCH],
    /// Of the ground that these clear the least: how far away it was, metres, where the ray to the eye was followed up to this height.
    occluder_way_m: [f32; BATCH],
    occluder_height_m: [f32; BATCH],
    /// The part of the slope that waves have.
    pub(super) waves: Vectors,
    /// How strong the next finer waves are here, before the cap.
    pub(super) strength: [f32; BATCH],
}

impl DetailSums {
    /// No detail, above which rays to the sun are free.
    #[inline(always)]
    pub(super) fn new() -> Self {
        let zeros = [0.0; BATCH];
        Self {
            x: zeros,
            y: zeros,
            shade: zeros,
            height_m: zeros,
            sun_clearance_m: [FAR_M; BATCH],
            occluder_way_m: [FAR_M; BATCH],
            occluder_height_m: zeros,
            waves: Vectors { x: zeros, y: zeros },
            strength: [1.0; BATCH],
        }
    }

    /// The point, metres from the centre of the ground, at which the ray to the eye of sample `i` has the height that is summed so far.
    #[inline(always)]
    pub(super) fn point(&self, ground: &GroundBatch, i: usize) -> Vec2 {
        let height_m = self.height_m[i];
        Vec2::new(ground.x[i] + height_m * ground.ways[0].x[i], ground.y[i] + height_m * ground.ways[0].y[i])
    }

    /// Adds detail of a size at that point: its slope, its height, and its shade. The height at which the ray leaves the ground is found by
    /// a step of Newton's method, with what is summed so far.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        ground: &GroundBatch,
        (i, size_m): (usize, f32),
        slope: Vec2,
        height_m: f32,
        shade: f32,
    ) {
        let rise_m = height_m / self.clearance(ground, i, slope);
        self.x[i] += slope.x;
        self.y[i] += slope.y;
        self.shade[i] += shade;
        self.move_up(ground, (i, size_m), rise_m);
    }

    /// Moves the point where the eye sees sample `i` up its ray, by a height in metres, as detail of a size does. A ray to the sun from there
    /// starts higher, but also further on its way. Detail that is more than twice as large as the way to the occluder lifts that in part too:
    /// else a crest would shadow the ground just below it wherever the two lie a little lower.
    #[inline(always)]
    pub(super) fn move_up(&mut self, ground: &GroundBatch, (i, size_m): (usize, f32), rise_m: f32) {
        self.height_m[i] += rise_m;
        let apart = 2.0 * self.occluder_way_m[i] / size_m;
        let apart = if apart < 1.0 { apart } else { 1.0 };
        self.sun_clearance_m[i] += ground.sun_lift[i] * rise_m * apart;
    }

    /// Takes ground at a horizontal distance from the point of each sample towards the sun for its occluder, if the ray to the sun clears no
    /// other by less.
    #[inline(always)]
    pub(super) fn add_occluders(&mut self, clearances_m: &[f32; BATCH], ways_m: &[f32; BATCH]) {
        for i in 0..BATCH {
            let is_nearest = if clearances_m[i] < self.sun_clearance_m[i] { u32::MAX } else { 0 };
            // Selections of bits: in any other form this does not vectorise.
            let nearest = |new: f32, old: f32| {
                f32::from_bits((new.to_bits() & is_nearest) | (old.to_bits() & !is_nearest))
            };
            self.sun_clearance_m[i] = nearest(clearances_m[i], self.sun_clearance_m[i]);
            self.occluder_way_m[i] = nearest(ways_m[i], self.occluder_way_m[i]);
            self.occluder_height_m[i] = nearest(self.height_m[i], self.occluder_height_m[i]);
        }
    }

    /// Share of the sun that relief hides, its penumbra `blur_m` high on the occluder.
    ///
    /// Finer relief moves the point on its ray to the eye, with the sun behind the camera also towards the sun: there the shadow loses
    /// strength until the point has reached the occluder, whose face towards the eye is lit. Extrapolated clearances alone would hide the
    /// sun from points beyond.
    #[inline(always)]
    pub(super) fn sun_hidden(&self, ground: &GroundBatch, i: usize, blur_m: f32) -> f32 {
        let hidden = (0.5 - 0.5 * self.sun_clearance_m[i] / blur_m).clamp(0.0, 1.0);
        let moved_m = ground.towards_sun[i] * (self.height_m[i] - self.occluder_height_m[i]);
        hidden * (1.0 - moved_m / self.occluder_way_m[i]).clamp(0.0, 1.0)
    }

    /// How much of relief of this size the mesh leaves out and samples can show, 0 to 1: samples on slopes that face away from the eye are
    /// further apart.
    #[inline(always)]
    pub(super) fn share(&self, ground: &GroundBatch, i: usize, size_m: f32) -> f32 {
        let clearance = self.clearance(ground, i, Vec2::ZERO);
        ground.share(i, size_m, if clearance < 1.0 { clearance.sqrt() } else { 1.0 })
    }

    /// [`Self::rise`] with this slope added, at least [`MIN_CLEARANCE`].
    #[inline(always)]
    pub(super) fn clearance(&self, ground: &GroundBatch, i: usize, slope: Vec2) -> f32 {
        let way = [ground.ways[0].x[i], ground.ways[0].y[i]];
        let clearance = 1.0 - ((self.x[i] + slope.x) * way[0] + (self.y[i] + slope.y) * way[1]);
        if clearance > MIN_CLEARANCE { clearance } else { MIN_CLEARANCE }
    }

    /// How much less the ground rises along the ray to the eye than the ray, relative to the ray.
    #[inline(always)]
    pub(super) fn rise(&self, ground: &GroundBatch, i: usize) -> f32 {
        1.0 - (self.x[i] * ground.ways[0].x[i] + self.y[i] * ground.ways[0].y[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A point in the shadow of a bump 4 cm away, and finer relief that moves it along its ray to the eye, 3 m for each that it rises.
    #[test]
    fn no_bump_shadows_its_face_towards_the_sun() {
        const BLUR_M: f32 = 1e-4;
        for (towards_sun, rise_m, hidden) in
            [(3.0, 0.0, 1.0), (3.0, 0.01, 0.25), (3.0, 0.02, 0.0), (3.0, -0.01, 1.0), (0.0, 0.02, 1.0)]
        {
            let mut ground = GroundBatch::towards_eye(Vec2::ZERO, 3.0, 1e-3, 0.05);
            ground.towards_sun = [towards_sun; BATCH];
            ground.sun_lift = [1.0 - towards_sun; BATCH];
            let mut sums = DetailSums::new();
            // So far below the edge of its shadow that no penumbra counts; ground that the ray clears by more does not count either.
            sums.add_occluders(&[-1.0; BATCH], &[0.04; BATCH]);
            sums.add_occluders(&[0.02; BATCH], &[0.01; BATCH]);
            sums.move_up(&ground, (0, 0.01), rise_m);
            let got = sums.sun_hidden(&ground, 0, BLUR_M);
            assert!((got - hidden).abs() < 1e-5, "{rise_m} m up, {towards_sun} towards the sun: {got}");
        }
    }

    /// A point just below a crest, on ground that larger or smaller relief lowers by twice as much as the ray to the sun clears the crest.
    #[test]
    fn relief_that_a_crest_shares_does_not_let_it_shadow_the_ground_below_it() {
        for (size_m, hidden) in [(0.5, 0.0), (0.1, 0.0), (0.02, 1.0), (0.005, 1.0)] {
            let mut ground = GroundBatch::towards_eye(Vec2::ZERO, 3.0, 1e-3, 0.05);
            ground.sun_lift = [1.0; BATCH];
            let mut sums = DetailSums::new();
            sums.add_occluders(&[0.008; BATCH], &[0.01; BATCH]);
            sums.move_up(&ground, (0, size_m), -0.016);
            let got = sums.sun_hidden(&ground, 0, 1e-4);
            assert_eq!(got, hidden, "relief of {size_m} m");
        }
    }
}
