//! What the cases look like where everything is right: frames of the host rasteriser on Mesa's CPU driver, shipped in the binary, and the
//! depth of the compute pass that rasterises.
//!
//! `assets/doctor` has, for each case, the hashes of its planes and the planes themselves as PNG: the hashes say whether a frame
//! is right, the planes where it is not. Depth is stored as 16-bit logarithm, which is coarser than the plane.
//! Must not know: adapters.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::cases::CASES;
use super::planes::{Hashes, Planes};
use crate::error::{Error, Result};

/// Least depth that the logarithm can store, metres.
const NEAREST_M: f64 = 0.05;
/// Largest depth that it can store, metres.
const FARTHEST_M: f64 = 1e6;
/// The value of the sky.
const SKY: u16 = u16::MAX;
/// Largest relative difference between a depth and what is stored of it: half a step.
pub const DEPTH_PRECISION: f64 = 1.3e-4;

/// A reference: the hashes of a case.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaseHashes {
    /// Hash of the scene's geometry.
    pub geometry: String,
    /// Hashes of the planes.
    #[serde(flatten)]
    pub planes: Hashes,
    /// Hash of the depth where a compute pass rasterises, which differs from that of the host rasteriser in the last bits.
    pub computed_depth: String,
}

/// The hashes of each case, as JSON by name.
const HASHES: &str = include_str!("../../assets/doctor/hashes.json");

/// Names of the planes' files, after the case's name.
pub const FILES: [&str; 4] = ["rgb", "mask", "instances", "depth"];

macro_rules! images {
    ($($case:literal),*) => {
        [$(($case, [
            include_bytes!(concat!("../../assets/doctor/", $case, "_rgb.png")),
            include_bytes!(concat!("../../assets/doctor/", $case, "_mask.png")),
            include_bytes!(concat!("../../assets/doctor/", $case, "_instances.png")),
            include_bytes!(concat!("../../assets/doctor/", $case, "_depth.png")),
        ])),*]
    };
}

/// The PNG files of each case, in the order of [`FILES`].
const IMAGES: [(&str, [&[u8]; 4]); CASES.len()] =
    images!("nominal", "nominal_backlit", "surface", "surface_low_sun", "surface_sensor", "surface_lens");

/// What a case looks like where everything is right.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Hashes of geometry and planes, exact.
    pub hashes: CaseHashes,
    /// The planes; depth to within [`DEPTH_PRECISION`].
    pub planes: Planes,
}

/// The reference of a case.
///
/// # Errors
/// [`Error::Encode`] if the shipped files are damaged: a bug.
pub fn reference(case: &str) -> Result<Reference> {
    let damaged = |message: String| Error::Encode { name: format!("assets/doctor/{case}"), message };
    let mut hashes: BTreeMap<String, CaseHashes> =
        serde_json::from_str(HASHES).map_err(|error| damaged(error.to_string()))?;
    let hashes = hashes.remove(case).ok_or_else(|| damaged("it has no hashes".to_owned()))?;
    let (_, files) = IMAGES
        .iter()
        .find(|(name, _)| *name == case)
        .ok_or_else(|| damaged("it has no images".to_owned()))?;
    let open = |file: &[u8]| image::load_from_memory(file).map_err(|error| damaged(error.to_string()));
    let [rgb, mask, instances, depth] = files;
    let rgb = open(rgb)?.into_rgb8();
    let planes = Planes {
        size: [rgb.width(), rgb.height()],
        rgb: rgb.into_raw(),
        mask: open(mask)?.into_luma8().into_raw(),
        instances: open(instances)?.into_luma16().into_raw(),
        depth_m: open(depth)?.into_luma16().into_raw().into_iter().map(decode_depth).collect(),
    };
    Ok(Reference { hashes, planes })
}

/// Steps of the stored logarithm from the nearest to the farthest depth.
fn steps() -> f64 {
    f64::from(SKY - 1) / libm::log(FARTHEST_M / NEAREST_M)
}

/// A depth as it is stored.
#[must_use]
pub fn encode_depth(depth_m: f32) -> u16 {
    if depth_m.is_infinite() {
        return SKY;
    }
    let step = steps() * libm::log(f64::from(depth_m) / NEAREST_M);
    step.round().clamp(0.0, f64::from(SKY - 1)) as u16
}

/// The depth that is stored, metres.
fn decode_depth(stored: u16) -> f32 {
    if stored == SKY { f32::INFINITY } else { (NEAREST_M * libm::exp(f64::from(stored) / steps())) as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_depth_is_as_precise_as_promised() {
        for depth_m in [0.06, 0.5, 1.0, 3.333_f32, 70.0, 12_345.0, 9e5] {
            let error = f64::from(decode_depth(encode_depth(depth_m)) / depth_m) - 1.0;
            assert!(error.abs() < DEPTH_PRECISION, "{depth_m}: {error}");
        }
        assert!(decode_depth(encode_depth(f32::INFINITY)).is_infinite());
    }

    #[test]
    fn every_case_has_a_reference_of_its_size() {
        for case in &CASES {
            let reference = reference(case.name).expect("a reference");
            assert_eq!(reference.planes.size, case.size, "{}", case.name);
            let (found, expected) = (reference.planes.hashes(), reference.hashes.planes);
            assert_eq!(
                (found.mask, found.instances, found.rgb),
                (expected.mask, expected.instances, expected.rgb)
            );
        }
    }
}
