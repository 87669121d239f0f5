//! The frames that every machine renders: small, of both stages, and together through every shader program.
//!
//! Must not know: adapters.
//! To add one: a row, then `REGOLITH_UPDATE_GOLDENS=1 cargo test --release --test suite doctor`, which writes its reference.

use crate::error::Result;
use crate::frame::{Annotation, Annotations};
use crate::params::config::Config;
use crate::render::RenderSettings;
use crate::scene::Scene;

/// A frame to render.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Its name in reports and in `assets/doctor`.
    pub name: &'static str,
    /// Seed of its scene.
    pub seed: u64,
    /// Knobs that differ from the defaults, as for `--set`.
    pub set: &'static [&'static str],
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Samples per pixel.
    pub samples: u32,
}

const fn case(
    name: &'static str,
    seed: u64,
    set: &'static [&'static str],
    size: [u32; 2],
    samples: u32,
) -> Case {
    Case { name, seed, set, size, samples }
}

/// Every case. Widths that are no multiple of 64 pixels show a wrong row pitch.
pub const CASES: [Case; 6] = [
    case("nominal", 42, &[], [128, 128], 4),
    case("nominal_backlit", 7, &["sun.elevation_deg=5", "sun.azimuth_deg=0"], [136, 104], 1),
    case("surface", 4, &["stage.name=surface"], [128, 128], 4),
    case(
        "surface_low_sun",
        36,
        &["stage.name=surface", "sun.elevation_deg=4", "rocks.coverage=0.02"],
        [120, 72],
        16,
    ),
    case(
        "surface_sensor",
        15,
        &["stage.name=surface", "sensor.kind=bayer", "camera.roll_deg=4"],
        [128, 96],
        4,
    ),
    case("surface_lens", 3, &["stage.name=surface", "camera.k1=-0.1"], [128, 96], 4),
];

impl Case {
    /// Builds its scene.
    ///
    /// # Errors
    /// Those of [`Config::draw`] and [`Scene::build`]: a bug, as the table is fixed.
    pub fn scene(&self) -> Result<Scene> {
        let mut config = Config::new();
        self.set.iter().try_for_each(|assignment| config.apply_set(assignment))?;
        Scene::build(self.seed, &config.draw(self.seed)?)
    }

    /// Its size and samples, with the planes that are compared.
    ///
    /// # Errors
    /// Those of [`RenderSettings::new`]: a bug, as the table is fixed.
    pub fn settings(&self) -> Result<RenderSettings> {
        let annotations: Annotations = [Annotation::Depth, Annotation::Instances].into_iter().collect();
        Ok(RenderSettings { annotations, ..RenderSettings::new(self.size, self.samples)? })
    }
}
