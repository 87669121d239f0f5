//! Which rocks and craters count in the labels: rules on objects, not on pixels.
//!
//! Must not know: how they are applied to an image.

use glam::Vec3;

use super::rocks::Rock;
use crate::params::{Knob, Params};

/// What the pixels of a rock become that is too small, or that nobody can see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LabelPolicy {
    /// The ignore index; the rock keeps its instance id.
    Ignore,
    /// Regolith, without an instance id.
    #[default]
    Regolith,
    /// Rock, as if it were any other.
    Rock,
}

impl LabelPolicy {
    /// The policy of a knob; the table of knobs allows no other text.
    fn of(params: &Params, knob: Knob) -> Self {
        match params.text(knob) {
            "ignore" => Self::Ignore,
            "regolith" => Self::Regolith,
            _ => Self::Rock,
        }
    }
}

/// Which rocks are labelled as rocks, and which craters are labelled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelRule {
    /// Rocks that would cover fewer pixels if unoccluded are too small.
    pub min_pixels: f32,
    /// Rocks with a smaller diameter, metres, are too small.
    pub min_diameter_m: f32,
    /// What rocks become that are too small.
    pub too_small: LabelPolicy,
    /// What rocks become that are large enough and cannot be seen.
    pub unseen: LabelPolicy,
    /// Smallest contrast of a rock that can be seen, in standard deviations of a pixel's noise.
    pub unseen_contrast: f64,
    /// Craters with a smaller diameter, metres, are not labelled.
    pub crater_min_diameter_m: f32,
    /// Craters with a smaller depth, in diameters, are not labelled.
    pub crater_min_depth: f32,
}

impl Default for LabelRule {
    /// Labels every rock and every crater.
    fn default() -> Self {
        Self {
            min_pixels: 0.0,
            min_diameter_m: 0.0,
            too_small: LabelPolicy::Regolith,
            unseen: LabelPolicy::Rock,
            unseen_contrast: 3.0,
            crater_min_diameter_m: 0.0,
            crater_min_depth: 0.0,
        }
    }
}

impl LabelRule {
    /// The rule of these parameters.
    #[must_use]
    pub fn build(params: &Params) -> Self {
        let number = |knob| params.number(knob) as f32;
        Self {
            min_pixels: number(Knob::LabelMinPixels),
            min_diameter_m: number(Knob::LabelMinDiameterM),
            too_small: LabelPolicy::of(params, Knob::LabelTooSmall),
            unseen: LabelPolicy::of(params, Knob::LabelUnseen),
            unseen_contrast: params.number(Knob::LabelUnseenContrast),
            crater_min_diameter_m: number(Knob::LabelCraterMinDiameterM),
            crater_min_depth: number(Knob::LabelCraterMinDepth),
        }
    }

    /// Whether a rock is large enough in an image with a focal length of `focal_px` pixels. Its silhouette is approximated by a
    /// disc of its diameter.
    #[must_use]
    pub fn is_large_enough(&self, rock: &Rock, eye: Vec3, focal_px: f32) -> bool {
        if self.min_diameter_m <= 0.0 && self.min_pixels <= 0.0 {
            return true;
        }
        let diameter_m = rock.diameter_m();
        let across_px = focal_px * diameter_m / rock.centre.distance(eye).max(1e-3);
        diameter_m >= self.min_diameter_m
            && 0.25 * std::f32::consts::PI * across_px * across_px >= self.min_pixels
    }

    /// Whether a rock is drawn as a rock, with an instance id, rather than as ground.
    #[must_use]
    pub fn draws_as_rock(&self, rock: &Rock, eye: Vec3, focal_px: f32) -> bool {
        self.too_small != LabelPolicy::Regolith || self.is_large_enough(rock, eye, focal_px)
    }

    /// Whether labels depend on the instance ids of the finished image.
    #[must_use]
    pub fn needs_instances(&self) -> bool {
        self.unseen != LabelPolicy::Rock || self.too_small == LabelPolicy::Ignore
    }
}
