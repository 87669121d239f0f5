//! The metadata of a frame: the content of `frame_N.json`.
//!
//! Must not know: how files are written.

use serde_json::{Map, Value, json};

use crate::class::ClassId;
use crate::frame::Frame;
use crate::output::LabelIds;
use crate::output::edges::{EdgePolicy, MaskCoverage, MaskIds};
use crate::params::{Knob, Params};
use crate::render::{RasterOptions, RenderSettings, StageTimes};
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::sky::Sun;

/// Everything that a frame's metadata is made from.
#[derive(Clone, Copy, Debug)]
pub struct FrameRecord<'a> {
    /// Seed of the scene.
    pub seed: u64,
    /// The value of every knob.
    pub params: &'a Params,
    /// The scene.
    pub scene: &'a Scene,
    /// Image size and samples per pixel.
    pub settings: &'a RenderSettings,
    /// The adapter that rendered it.
    pub adapter: &'a wgpu::AdapterInfo,
    /// How the device and the host share the work.
    pub raster: RasterOptions,
    /// The rendered frame.
    pub frame: &'a Frame,
    /// The mask of the frame as it is written.
    pub mask: &'a MaskIds,
    /// The numbering of the classes in the mask.
    pub label_ids: LabelIds,
    /// Milliseconds of work by stage.
    pub times: &'a StageTimes,
}

impl FrameRecord<'_> {
    /// The metadata as JSON.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let info = self.adapter;
        let mut coverage: Map<String, Value> = ClassId::ALL
            .iter()
            .map(|class| (class.name.to_owned(), self.frame.coverage(class.id).into()))
            .collect();
        let fraction = |pixels: u64| Value::from(pixels as f64 / self.frame.class.len() as f64);
        let of_rule = self.frame.label_pixels;
        let others = [
            ("unlabelled", self.frame.unlabelled_px()),
            ("ignored", of_rule.ignored),
            ("too_small", of_rule.too_small),
            ("unseen", of_rule.unseen),
        ];
        coverage.extend(others.map(|(name, pixels)| (name.to_owned(), fraction(pixels))));
        let ms: Map<String, Value> = self
            .times
            .iter()
            .map(|&(stage, ms)| (stage.to_owned(), json!((ms * 1e3).round() / 1e3)))
            .collect();
        let mut record = json!({
            "seed": self.seed,
            "stage": self.params.text(Knob::StageName),
            "size": self.settings.size,
            "samples": self.settings.samples_per_side.pow(2),
            "edges": self.mask.edges().to_string(),
            "label_ids": self.label_ids.name(),
            "version": env!("CARGO_PKG_VERSION"),
            "adapter": {
                "name": info.name,
                "backend": info.backend.to_string(),
                "driver": format!("{} {}", info.driver, info.driver_info).trim(),
            },
            "raster": self.raster.name(),
            "knobs": self.params.to_json(),
            "geometry_hash": self.scene.geometry_hash(),
            "camera": camera(&self.scene.camera, self.settings.size),
            "sun": sun(&self.scene.sun),
            "coverage": coverage,
            "exposure": self.frame.exposure,
            "rgb": self.frame.rgb_statistics(),
            "moved_rocks": self.scene.moved_rocks(),
            "left_out_rocks": self.scene.left_out_rocks,
            "ms": ms,
        });
        if let (true, Value::Object(record)) = (self.mask.edges() != EdgePolicy::Hard, &mut record) {
            record.insert("mask_coverage".to_owned(), mask_coverage(&self.mask.coverage(self.frame)));
        }
        record
    }
}

/// The `mask_coverage` of a frame's metadata.
fn mask_coverage(mask: &MaskCoverage) -> Value {
    let classes = ClassId::ALL.iter().zip(mask.classes).map(|(class, share)| (class.name, share));
    let fractions = classes.chain([("ignored", mask.ignored)]);
    fractions.map(|(name, share)| (name.to_owned(), share.into())).collect::<Map<_, _>>().into()
}

/// The `sun` of a frame's metadata.
#[must_use]
pub fn sun(sun: &Sun) -> Value {
    json!({
        "direction": sun.direction.to_array(),
        "elevation_deg": sun.elevation_deg,
        "azimuth_deg": sun.azimuth_deg,
        "angular_diameter_deg": sun.angular_diameter_deg,
    })
}

/// The `camera` of a frame's metadata: intrinsics in pixels (pixel (u, v) has its centre at (u + 0.5, v + 0.5)), lens
/// distortion, and the pose as row-major matrices.
#[must_use]
pub fn camera(camera: &Camera, size: [u32; 2]) -> Value {
    let k = camera.intrinsics(size);
    json!({
        "fx": k[0][0],
        "fy": k[1][1],
        "cx": k[0][2],
        "cy": k[1][2],
        "K": k,
        "fov_deg": camera.fov_deg(),
        "world_from_camera": camera.world_from_camera(),
        "world_from_camera_gl": camera.world_from_camera_gl(),
        "distortion": {
            "k1": camera.lens.k1,
            "k2": camera.lens.k2,
            "p1": camera.lens.p1,
            "p2": camera.lens.p2,
            "k3": camera.lens.k3,
        },
        "near_m": camera.near_m,
        "far_m": camera.far_m,
        "exposure_ev": camera.exposure_ev,
    })
}
