//! The sun in the image of a sensor: its disc through the point spread function, the light that the lens scatters, and ghosts.
//!
//! The disc is 10,000 to 100,000 times as bright as the ground and saturates the half-precision radiance, so it is taken out of the
//! image before a sensor meters and filters it, and added at its true radiance afterwards. The share of it that terrain and rocks hide
//! from the lens is counted on the triangles, so that it does not depend on pixels.
//!
//! Scatter by polished and slightly dusty lenses falls with the square of the angle beyond a core (the ABg model with g = 2, Pfisterer
//! 2011, "Approximated Scatter Models for Stray Light Analysis"; Harvey 1976). In the chord c between two directions, for which
//! dOmega = 2 pi c dc, that is a density per solid angle of share / (pi ln(1 + 4 / B) (B + c^2)), whose integral over the sphere is the
//! share.
//! Must not know: wgpu, noise, exposure.

use glam::{Vec2, Vec3};
use half::f16;

use super::image_rays::ImageRays;
use super::sun_share::visible_share;
use crate::frame::Frame;
use crate::scene::Scene;
use crate::scene::flare::Ghost;
use crate::scene::sky::{Sun, stored_radiance};

/// B of the scatter model: the square of the chord at which it has fallen to half, 0.01 radians.
const SCATTER_CORE: f32 = 1e-4;
/// Angle outside of the image from which on a hood keeps the sun's light off the lens; the lit part falls linearly up to there, radians.
const HOOD_ANGLE: f32 = 0.35;
/// Least cosine of the angle between sun and optical axis.
const MIN_COSINE: f32 = 0.05;
/// A pixel of which the disc covers less is none of its pixels; the brightest ground has less than a hundredth of its radiance.
const MIN_COVERED: f32 = 0.02;
/// Points along each side of a pixel at which the darkening of the limb is asked for.
const LIMB_STEPS: usize = 4;
/// Points of the sun's limb that bound where its disc lies in the image.
const LIMB_POINTS: u32 = 16;
/// The soft edge of a ghost, in radii.
const GHOST_EDGE: f32 = 0.2;

/// The sun as an image shows it.
#[derive(Clone, Debug)]
pub struct SunGlare {
    /// Rays of the image's pixels.
    pub(super) rays: ImageRays,
    /// Unit vector towards the sun in axes of the camera: x right, y down, z forward.
    towards: Vec3,
    /// Irradiance at the lens of the part of the disc that is not hidden.
    irradiance: Vec3,
    /// Pixels that show the disc, with their radiance that a frame holds and that of the disc in them.
    disc: Vec<(usize, [f16; 3], Vec3)>,
    ghosts: Vec<Ghost>,
}

impl SunGlare {
    /// Takes the sun out of a frame of `scene`, if it stands in or near its image. The frame has its lens, focal length and radiance.
    #[must_use]
    pub fn take(frame: &mut Frame, scene: &Scene) -> Option<Self> {
        let (camera, sun) = (&scene.camera, &scene.sun);
        let axes = [camera.right, -camera.up, camera.forward];
        let towards = Vec3::from(axes.map(|axis| axis.dot(sun.direction)));
        let lit = lit_part(towards, frame).filter(|_| sun.irradiance.max_element() > 0.0)?;
        let share = visible_share(scene);
        let mut glare = Self {
            rays: ImageRays::new(frame),
            towards,
            irradiance: lit * share as f32 * sun.irradiance,
            disc: Vec::new(),
            ghosts: scene.flare.ghosts.clone(),
        };
        glare.take_disc(frame, sun, scene.sky.radiance);
        Some(glare)
    }

    /// Replaces the disc in the frame by the sky around it.
    fn take_disc(&mut self, frame: &mut Frame, sun: &Sun, sky: Vec3) {
        let Some([columns, rows]) = self.disc_bounds(sun) else { return };
        let stored = stored_radiance(sun.disc_radiance());
        let (channel, _) =
            (0..3).map(|c| (c, stored[c])).fold((0, 0.0), |a, b| if b.1 > a.1 { b } else { a });
        for y in rows {
            for x in columns.clone() {
                let pixel = y * self.rays.size[0] + x;
                let radiance = &mut frame.radiance[3 * pixel..3 * pixel + 3];
                let disc = self.radiance_in(sun, [x, y]);
                let covered = radiance[channel].to_f32() / stored_radiance(disc)[channel];
                if covered >= MIN_COVERED {
                    self.disc.push((pixel, [radiance[0], radiance[1], radiance[2]], covered.min(1.0) * disc));
                    radiance.copy_from_slice(&sky.to_array().map(f16::from_f32));
                }
            }
        }
    }

    /// Mean radiance of the disc in a pixel where it covers it: that of the limb where none of the points that are asked is on it.
    fn radiance_in(&self, sun: &Sun, [x, y]: [usize; 2]) -> Vec3 {
        let steps = 0..LIMB_STEPS * LIMB_STEPS;
        let at = |step: usize| (step as f64 + 0.5) / LIMB_STEPS as f64;
        // In the axes of the camera, as `towards` is.
        let sun = Sun { direction: self.towards, ..*sun };
        let (mut sum, mut points) = (Vec3::ZERO, 0.0);
        for step in steps {
            let point = self.rays.point([x as f64 + at(step % LIMB_STEPS), y as f64 + at(step / LIMB_STEPS)]);
            let ray = point.extend(1.0) / point.extend(1.0).length();
            let cosine = sun.cosine_along(ray);
            if cosine > 0.0 {
                sum += sun.radiance_at(cosine);
                points += 1.0;
            }
        }
        if points > 0.0 { sum / points } else { sun.radiance_at(0.0) }
    }

    /// Puts the disc back as the frame had it, for outputs of the radiance.
    pub fn restore(&self, frame: &mut Frame) {
        for (pixel, stored, _) in &self.disc {
            frame.radiance[3 * pixel..3 * pixel + 3].copy_from_slice(stored);
        }
    }

    /// Columns and rows of the image within which the disc lies.
    fn disc_bounds(&self, sun: &Sun) -> Option<[std::ops::Range<usize>; 2]> {
        let (u, v) = self.towards.any_orthonormal_pair();
        let tangent = sun.tan_half_angle();
        let on_limb = (0..LIMB_POINTS).map(|k| {
            let angle = std::f32::consts::TAU * k as f32 / LIMB_POINTS as f32;
            self.towards + tangent * (libm::cosf(angle) * u + libm::sinf(angle) * v)
        });
        let positions = on_limb.chain([self.towards]).map(|ray| {
            let point = ray.truncate() / ray.z.max(MIN_COSINE);
            self.rays.position(point)
        });
        let whole = [Vec2::INFINITY, Vec2::NEG_INFINITY];
        let [low, high] = positions.fold(whole, |[low, high], at| [low.min(at), high.max(at)]);
        // Between two of the points the limb reaches 2 % of its radius further.
        let margin = 0.03 * (high - low) + 2.0;
        let (low, high) = (low - margin, high + margin);
        let bounds = [0, 1].map(|axis| {
            let clamped = |px: f32| px.clamp(0.0, self.rays.size[axis] as f32);
            clamped(low[axis]) as usize..clamped(high[axis].ceil()) as usize
        });
        bounds.iter().all(|range| !range.is_empty()).then_some(bounds)
    }

    /// Adds the light that the lens scatters, `scattered` of all, and the ghosts to the channels of an image, linear radiance.
    /// `channel_of` gives a channel's response to a colour.
    pub fn add_stray_light(
        &self,
        channels: &mut [Vec<f32>],
        channel_of: impl Fn(usize, Vec3) -> f32,
        scattered: f64,
    ) {
        let width = self.rays.size[0];
        let norm = std::f32::consts::PI * libm::logf(1.0 + 4.0 / SCATTER_CORE);
        let scatter = scattered as f32 / norm * self.irradiance;
        let ghosts = self.ghosts_in_image();
        let light: Vec<Vec<f32>> = (0..channels.len())
            .map(|number| {
                let ghosts = ghosts.iter().map(|(.., radiance)| *radiance);
                std::iter::once(scatter).chain(ghosts).map(|light| channel_of(number, light)).collect()
            })
            .collect();
        // Of each pixel of a row: the scattered part of the irradiance, and the lit part of each ghost.
        let parts = 1 + ghosts.len();
        let mut shares = vec![0.0; parts * width];
        let mut points = vec![Vec2::ZERO; width];
        for y in 0..self.rays.size[1] {
            self.rays.row(y, &mut points);
            for (point, shares) in points.iter().zip(shares.chunks_exact_mut(parts)) {
                let ray = point.extend(1.0) / point.extend(1.0).length();
                shares[0] = 1.0 / (SCATTER_CORE + ray.distance_squared(self.towards));
                for (share, (centre, tan_radius, _)) in shares[1..].iter_mut().zip(&ghosts) {
                    let inside = (1.0 - point.distance(*centre) / tan_radius) / GHOST_EDGE;
                    *share = inside.clamp(0.0, 1.0);
                }
            }
            for (channel, light) in channels.iter_mut().zip(&light) {
                let row = &mut channel[y * width..(y + 1) * width];
                for (value, shares) in row.iter_mut().zip(shares.chunks_exact(parts)) {
                    *value += shares.iter().zip(light).map(|(share, light)| share * light).sum::<f32>();
                }
            }
        }
    }

    /// Adds the disc to the channels of an image, linear radiance times `gain` and the share in `falloff` that the vignetting leaves,
    /// blurred by a Gaussian of this standard deviation, pixels, which leaves out the pixel's own aperture; `scattered` of its light is
    /// elsewhere.
    pub fn add_disc(
        &self,
        channels: &mut [Vec<f32>],
        channel_of: impl Fn(usize, Vec3) -> f32,
        (gain, falloff): (f32, &[f32]),
        (sigma_px, scattered): (f64, f64),
    ) {
        let ([columns, rows], light) = self.spread_disc(sigma_px);
        for (number, channel) in channels.iter_mut().enumerate() {
            for (y, lights) in rows.clone().zip(light.chunks_exact(columns.len().max(1))) {
                for (x, light) in columns.clone().zip(lights) {
                    let pixel = y * self.rays.size[0] + x;
                    let direct = (1.0 - scattered as f32) * channel_of(number, *light);
                    channel[pixel] += gain * falloff[pixel] * direct;
                }
            }
        }
    }

    /// Radiance of the disc after the blur, and the columns and rows that it is for. The Gaussian has no negative
    /// lobes: those of a kernel that is sharper would be black rings around something so bright.
    fn spread_disc(&self, sigma_px: f64) -> ([std::ops::Range<usize>; 2], Vec<Vec3>) {
        let [width, _] = self.rays.size;
        let Some(((first_x, last_x), (first_y, last_y))) =
            self.disc.iter().fold(None, |bounds, (pixel, ..)| {
                let (x, y) = (pixel % width, pixel / width);
                let ((left, right), (top, bottom)) = bounds.unwrap_or(((x, x), (y, y)));
                Some(((left.min(x), right.max(x)), (top.min(y), bottom.max(y))))
            })
        else {
            return ([0..0, 0..0], Vec::new());
        };
        let reach = (4.0 * sigma_px).ceil() as usize;
        let weight = |offset: usize| {
            if sigma_px > 0.0 {
                libm::exp(-0.5 * offset as f64 * offset as f64 / (sigma_px * sigma_px))
            } else {
                f64::from(offset == 0)
            }
        };
        let sum = 2.0 * (0..=reach).map(weight).sum::<f64>() - 1.0;
        let weights: Vec<f32> = (0..=reach).map(|offset| (weight(offset) / sum) as f32).collect();
        let columns = first_x.saturating_sub(reach)..(last_x + reach + 1).min(width);
        let rows = first_y.saturating_sub(reach)..(last_y + reach + 1).min(self.rays.size[1]);
        let mut spread = vec![Vec3::ZERO; columns.len() * rows.len()];
        for (pixel, _, light) in &self.disc {
            let (x, y) = (pixel % width, pixel / width);
            for to_y in y.saturating_sub(reach)..(y + reach + 1).min(self.rays.size[1]) {
                for to_x in x.saturating_sub(reach)..(x + reach + 1).min(width) {
                    let at = (to_y - rows.start) * columns.len() + to_x - columns.start;
                    spread[at] += weights[to_x.abs_diff(x)] * weights[to_y.abs_diff(y)] * *light;
                }
            }
        }
        ([columns, rows], spread)
    }

    /// Centre, tangent of the radius and radiance of each ghost. The light falls off to the edge within [`GHOST_EDGE`].
    fn ghosts_in_image(&self) -> Vec<(Vec2, f32, Vec3)> {
        let sun = self.towards.truncate() / self.towards.z;
        let ghost = |ghost: &Ghost| {
            let area = std::f32::consts::PI * ghost.tan_radius * ghost.tan_radius;
            let e = GHOST_EDGE;
            // Of a disc with the height min(1, (1 - r) / e): its volume over that of one with the height 1.
            let fill = 1.0 - e + e * e / 3.0;
            (ghost.position * sun, ghost.tan_radius, ghost.share * self.irradiance / (area * fill))
        };
        self.ghosts.iter().map(ghost).collect()
    }
}

/// Part of the lens that the sun shines on: 1 if the sun stands in the image, less outside, by the shade of the hood. `None` for 0.
fn lit_part(towards: Vec3, frame: &Frame) -> Option<f32> {
    if towards.z < MIN_COSINE {
        return None;
    }
    let half = [frame.width, frame.height].map(|side| 0.5 * f64::from(side) / frame.focal_px);
    let reach = if frame.lens.is_pinhole() { [1.0; 2] } else { frame.lens.reach(half).unwrap_or([1.0; 2]) };
    let edge = Vec2::new((half[0] * reach[0]) as f32, (half[1] * reach[1]) as f32);
    let sun = towards.truncate() / towards.z;
    let nearest = sun.clamp(-edge, edge).extend(1.0);
    let outside = 2.0 * libm::asinf(0.5 * (nearest / nearest.length()).distance(towards));
    (outside < HOOD_ANGLE).then_some(1.0 - outside / HOOD_ANGLE)
}
