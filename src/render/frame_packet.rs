//! What a frame is asked for, before a device is needed.
//! Must not know: a device, buffers.

use crate::error::Result;
use crate::frame::{Annotation, Annotations};
use crate::render::post::hazards;
use crate::render::select::near_plane;
use crate::render::settings::RenderSettings;
use crate::scene::Scene;

/// What the caller asked for, and what has to be rendered for it.
#[derive(Debug)]
pub(crate) struct FrameRequest {
    /// Annotations that the caller asked for.
    pub(crate) annotations: Annotations,
    /// Settings of the image, with what post-processing needs besides.
    pub(crate) image: RenderSettings,
    /// If a lens distorts the image: the wider pinhole image that is rendered, from which the resolve pass takes its samples.
    pub(crate) undistorted: Option<(Scene, RenderSettings)>,
}

impl FrameRequest {
    pub(crate) fn new(scene: &Scene, settings: &RenderSettings) -> Result<Self> {
        let annotations = settings.annotations;
        let mut image = *settings;
        image.annotations = hazards::with_inputs(annotations);
        if scene.sensor.is_some() {
            image.annotations = image.annotations.with(Annotation::Hdr);
        }
        let (camera, size) = near_plane::checked(scene, image.size)?;
        let undistorted = (!camera.lens.is_pinhole())
            .then(|| (Scene { camera, ..scene.clone() }, RenderSettings { size, ..image }));
        Ok(Self { annotations, image, undistorted })
    }

    /// Scene and settings of the image before distortion.
    pub(crate) fn rendered<'a>(&'a self, scene: &'a Scene) -> (&'a Scene, &'a RenderSettings) {
        self.undistorted.as_ref().map_or((scene, &self.image), |(scene, settings)| (scene, settings))
    }
}
