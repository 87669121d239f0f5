//! A rendered frame in memory: the planes that the renderer returns and the encoders write.
//!
//! Must not know: how it was rendered.

mod annotation;
pub mod plane;

use crate::class::ClassId;
use crate::lens::Lens;
pub use annotation::{Annotation, Annotations};
use plane::{OwnedValues, PLANES, Plane, Values};

/// The planes of one frame, rows from top to bottom without padding. Planes that were not requested are empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Focal length, pixels; the principal point is the centre of the image.
    pub focal_px: f64,
    /// The distortion of the lens, which is applied to every plane.
    pub lens: Lens,
    /// Samples of each pixel.
    pub samples: u32,
    /// How the radiance became the 8-bit image.
    pub exposure: ImageExposure,
    /// 8-bit sRGB, three values per pixel.
    pub rgb: Vec<u8>,
    /// Class id.
    pub class: Vec<u8>,
    /// Distance along the optical axis at the pixel's centre, metres; infinite for the sky.
    pub depth_m: Vec<f32>,
    /// Unit normal in world space, three values per pixel; 0 for the sky.
    pub normals: Vec<f32>,
    /// Instance id of the rock; 0 where there is none.
    pub instances: Vec<u16>,
    /// Occluded fraction of the sun's disc, 0 (lit) to 255 (full shadow); 0 for the sky.
    pub sun_occlusion: Vec<u8>,
    /// Linear radiance before exposure and tone curve, three values per pixel.
    pub radiance: Vec<half::f16>,
    /// Number of samples of each class, by class id. A visible rover's are of none.
    pub sample_counts: Vec<[u8; 3]>,
    /// Slope of the ground over half a metre, degrees; NaN where there is no ground.
    pub slope_deg: Vec<f32>,
    /// 1 inside a crater, 2 on its rim, else 0.
    pub craters: Vec<u8>,
    /// Angle between the normal and the sun, degrees; NaN for the sky.
    pub incidence_deg: Vec<f32>,
    /// Phase angle: at the surface, between the sun and the camera, degrees; NaN for the sky.
    pub phase_deg: Vec<f32>,
    /// Class id, with 3 for the inside of craters and 4 for far ground.
    pub five_classes: Vec<u8>,
    /// The visible rocks, if instances were requested.
    pub rocks: Vec<RockLabel>,
    /// Pixels of rocks that the label rule singles out.
    pub label_pixels: LabelPixels,
}

/// Why a rock is ignored, if it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LabelReason {
    /// It is not: it is labelled as a rock.
    #[default]
    Rock,
    /// It is smaller than the smallest rock that counts.
    TooSmall,
    /// It is large enough, and cannot be seen.
    Unseen,
}

impl LabelReason {
    /// Every reason with its name in the instance mapping.
    pub const ALL: [(Self, &'static str); 3] =
        [(Self::Rock, "rock"), (Self::TooSmall, "too_small"), (Self::Unseen, "unseen")];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    /// The reason of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|(_, known)| *known == name).map(|(reason, _)| reason)
    }
}

/// Numbers of pixels of rocks that a label rule singles out, before they became what the rule says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LabelPixels {
    /// Of rocks that are too small.
    pub too_small: u64,
    /// Of rocks that are large enough and cannot be seen.
    pub unseen: u64,
    /// Pixels that carry the ignore index by rule, of the two above.
    pub ignored: u64,
}

/// Size and visibility of a rock in the image.
#[derive(Clone, Debug, PartialEq)]
pub struct RockLabel {
    /// Its instance id.
    pub instance: u16,
    /// Number of pixels of its instance id.
    pub visible_px: u32,
    /// Number of pixels that it would have if no other rock and no ground stood in front of it; its part below the ground does
    /// not count.
    pub exposed_px: u32,
    /// Smallest and largest column and row of its pixels: left, top, right, bottom, all included.
    pub box_px: [u32; 4],
    /// Height of its top above the ground at its centre, metres.
    pub height_m: f32,
    /// Mean of its two horizontal extents, metres.
    pub diameter_m: f32,
    /// Why it is ignored, if it is.
    pub reason: LabelReason,
}

impl RockLabel {
    /// The fraction of `exposed_px` that is not visible, 0 to 1.
    #[must_use]
    pub fn occluded(&self) -> f64 {
        1.0 - f64::from(self.visible_px) / f64::from(self.exposed_px.max(self.visible_px))
    }
}

/// How the radiance of a frame became the 8-bit image.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImageExposure {
    /// The exposure, stops: that of the camera, or what automatic exposure chose.
    pub ev: f32,
    /// The light that became black: exposed radiance, where 1 is the full well of a sensor, or white of the tone curve.
    pub black: f32,
    /// The light that became white, at most 1.
    pub white: f32,
}

/// Statistics of the 8-bit image over all pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RgbStatistics {
    /// Mean value, 0 to 255.
    pub mean: f64,
    /// 99th percentile: the smallest value that 99 % of the values do not exceed.
    pub p99: u8,
    /// Largest value.
    pub max: u8,
    /// Sum of the values of each channel: red, green, blue. Datasets of version 0.1 do not record it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sum: Option<[u64; 3]>,
    /// Sum of their squares.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sum_of_squares: Option<[u64; 3]>,
}

impl Frame {
    /// The values of a plane.
    #[must_use]
    pub fn plane(&self, plane: Plane) -> Values<'_> {
        match plane {
            Plane::Rgb => Values::U8(&self.rgb),
            Plane::Class => Values::U8(&self.class),
            Plane::Depth => Values::F32(&self.depth_m),
            Plane::Normals => Values::F32(&self.normals),
            Plane::Instances => Values::U16(&self.instances),
            Plane::SunOcclusion => Values::U8(&self.sun_occlusion),
            Plane::Radiance => Values::F16(&self.radiance),
            Plane::SampleCounts => Values::U8(self.sample_counts.as_flattened()),
            Plane::Slope => Values::F32(&self.slope_deg),
            Plane::Craters => Values::U8(&self.craters),
            Plane::Incidence => Values::F32(&self.incidence_deg),
            Plane::Phase => Values::F32(&self.phase_deg),
            Plane::FiveClasses => Values::U8(&self.five_classes),
        }
    }

    /// Moves the values of a plane out of the frame, which then lacks it.
    #[must_use]
    pub fn take_plane(&mut self, plane: Plane) -> OwnedValues {
        use std::mem::take;
        match plane {
            Plane::Rgb => OwnedValues::U8(take(&mut self.rgb)),
            Plane::Class => OwnedValues::U8(take(&mut self.class)),
            Plane::Depth => OwnedValues::F32(take(&mut self.depth_m)),
            Plane::Normals => OwnedValues::F32(take(&mut self.normals)),
            Plane::Instances => OwnedValues::U16(take(&mut self.instances)),
            Plane::SunOcclusion => OwnedValues::U8(take(&mut self.sun_occlusion)),
            Plane::Radiance => OwnedValues::F16(take(&mut self.radiance)),
            Plane::SampleCounts => OwnedValues::U8(take(&mut self.sample_counts).into_flattened()),
            Plane::Slope => OwnedValues::F32(take(&mut self.slope_deg)),
            Plane::Craters => OwnedValues::U8(take(&mut self.craters)),
            Plane::Incidence => OwnedValues::F32(take(&mut self.incidence_deg)),
            Plane::Phase => OwnedValues::F32(take(&mut self.phase_deg)),
            Plane::FiveClasses => OwnedValues::U8(take(&mut self.five_classes)),
        }
    }

    /// Bytes of all planes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        PLANES.iter().map(|row| (self.plane(row.plane).len() * row.dtype.bytes()) as u64).sum()
    }

    /// Number of pixels of a class.
    #[must_use]
    pub fn count(&self, class: ClassId) -> u64 {
        self.class.iter().filter(|&&id| id == class.0).count() as u64
    }

    /// Fraction of the pixels that a class covers.
    #[must_use]
    pub fn coverage(&self, class: ClassId) -> f64 {
        self.count(class) as f64 / self.class.len() as f64
    }

    /// Fraction of the pixels that carry the ignore index by rule, and not because nothing was drawn there.
    #[must_use]
    pub fn ignored(&self) -> f64 {
        self.label_pixels.ignored as f64 / self.class.len() as f64
    }

    /// Number of pixels without a label that no rule accounts for; a correct frame has none.
    #[must_use]
    pub fn unlabelled_px(&self) -> u64 {
        self.count(ClassId::UNLABELLED).saturating_sub(self.label_pixels.ignored)
    }

    /// Mean, 99th percentile and maximum of the image.
    #[must_use]
    pub fn rgb_statistics(&self) -> RgbStatistics {
        RgbStatistics::of(&self.rgb)
    }
}

impl RgbStatistics {
    /// The statistics of a list of values, three per pixel, which must not be empty.
    #[must_use]
    pub fn of(rgb: &[u8]) -> Self {
        let mut channels = [[0_u64; 256]; 3];
        for pixel in rgb.chunks_exact(3) {
            for (channel, &value) in channels.iter_mut().zip(pixel) {
                channel[usize::from(value)] += 1;
            }
        }
        let weighted = |weight: fn(u64) -> u64| {
            channels
                .map(|channel| (0..).zip(channel).map(|(value, count)| weight(value) * count).sum::<u64>())
        };
        let (sum, sum_of_squares) = (weighted(|value| value), weighted(|value| value * value));
        let histogram: [u64; 256] =
            std::array::from_fn(|value| channels.iter().map(|channel| channel[value]).sum());
        let total = rgb.len() as u64;
        let quantile = |needed: u64| {
            let mut below = 0;
            (0..=255_u8).find(|&value| {
                below += histogram[usize::from(value)];
                below >= needed
            })
        };
        Self {
            mean: sum.iter().sum::<u64>() as f64 / total as f64,
            p99: quantile((total * 99).div_ceil(100)).unwrap_or(u8::MAX),
            max: quantile(total).unwrap_or(u8::MAX),
            sum: Some(sum),
            sum_of_squares: Some(sum_of_squares),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_and_coverage_of_a_known_frame() {
        let mut rgb = vec![10_u8; 300];
        rgb[0] = 250;
        rgb[1] = 200;
        rgb[2] = 200;
        rgb[3] = 200;
        let frame = Frame {
            width: 10,
            height: 10,
            rgb,
            class: [vec![0; 60], vec![1; 30], vec![2; 10]].concat(),
            ..Frame::default()
        };
        let statistics = frame.rgb_statistics();
        assert!((statistics.mean - (296.0 * 10.0 + 850.0) / 300.0).abs() < 1e-12);
        assert_eq!((statistics.p99, statistics.max), (200, 250));
        assert_eq!(statistics.sum, Some([250 + 200 + 980, 200 + 990, 200 + 990]));
        assert_eq!(statistics.sum_of_squares.map(|[red, ..]| red), Some(62_500 + 40_000 + 9_800));
        assert_eq!(frame.count(ClassId::REGOLITH), 60);
        assert!((frame.coverage(ClassId::SKY) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn rows_are_in_the_order_of_the_enum_and_agree_with_the_frame() {
        for (index, row) in PLANES.iter().enumerate() {
            assert_eq!(row.plane as usize, index, "{}", row.name);
            assert_eq!(Frame::default().plane(row.plane).dtype(), row.dtype, "{}", row.name);
            assert_eq!(PLANES.iter().filter(|other| other.name == row.name).count(), 1, "{}", row.name);
        }
    }
}
