//! Frame packets: all that is chosen and computed for a frame before a device is needed. Made by any thread, submitted by the one
//! that owns the device.
//! Must not know: how a frame is recorded.

use std::sync::Arc;
use std::time::Instant;

use crate::error::Result;
use crate::frame::{Annotation, Annotations};
use crate::gpu::upload::UploadPool;
use crate::render::backend::RasterOptions;
use crate::render::device::timing::milliseconds;
use crate::render::frame_plan::{FramePlan, PlanCache};
use crate::render::post::hazards;
use crate::render::select::near_plane;
use crate::render::settings::RenderSettings;
use crate::render::staged_frame::StagedFrame;
pub use crate::render::staged_frame::Staging;
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
    fn new(scene: &Scene, settings: &RenderSettings) -> Result<Self> {
        settings.check(settings.samples())?;
        let annotations = settings.annotations;
        let mut image = *settings;
        image.annotations = hazards::with_inputs(annotations);
        if scene.label_rule.needs_instances() {
            image.annotations = image.annotations.with(Annotation::Instances);
        }
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

/// Plans frames for a renderer, on any number of threads at a time. A packet depends on scene and settings alone, not on the thread
/// and not on other packets.
#[derive(Debug)]
pub struct FramePlanner {
    raster: RasterOptions,
    cache: PlanCache,
    uploads: Arc<UploadPool>,
}

impl FramePlanner {
    /// A planner for renderers with these options.
    pub(crate) fn new(raster: RasterOptions, uploads: UploadPool) -> Self {
        Self { raster, cache: PlanCache::default(), uploads: Arc::new(uploads) }
    }

    /// A planner of the same renderer, from when it has these options.
    pub(crate) fn with_options(&self, raster: RasterOptions) -> Self {
        Self { raster, cache: PlanCache::default(), uploads: Arc::clone(&self.uploads) }
    }

    /// Plans a frame of a scene, on this thread and those of its rayon pool.
    ///
    /// # Errors
    /// [`Error::Usage`](crate::Error::Usage) for a size or a number of samples that [`RenderSettings::new`] refuses;
    /// [`Error::Scene`](crate::Error::Scene), see [`near_plane::checked`]; [`Error::Contradiction`](crate::Error::Contradiction) for more
    /// rocks, stars or shadows in view than a device holds.
    pub fn plan(&self, scene: &Scene, settings: &RenderSettings) -> Result<FramePacket> {
        let start = Instant::now();
        let request = FrameRequest::new(scene, settings)?;
        let (rendered_scene, rendered) = request.rendered(scene);
        let plan = FramePlan::new(&self.cache, rendered_scene, rendered, settings.size, &self.raster)?;
        Ok(FramePacket { request, plan, staged: None, plan_ms: milliseconds(start.elapsed()) })
    }

    /// Plans a frame of a scene, and writes what the device needs of it to where it copies from: the thread that submits the packet need
    /// not.
    ///
    /// # Errors
    /// Those of [`Self::plan`].
    pub fn plan_and_stage(
        &self,
        scene: &Scene,
        settings: &RenderSettings,
        staging: Staging,
    ) -> Result<FramePacket> {
        let mut packet = self.plan(scene, settings)?;
        let start = Instant::now();
        if packet.plan.map_source.is_some() && !packet.plan.draws.draws.is_empty() {
            let rendered = packet.request.rendered(scene).0;
            packet.staged = StagedFrame::new(&self.uploads, rendered, &packet.plan, staging);
        }
        packet.plan_ms += milliseconds(start.elapsed());
        Ok(packet)
    }
}

/// A frame that is planned, for [`Renderer::submit_packet`](super::Renderer::submit_packet).
#[derive(Debug)]
pub struct FramePacket {
    pub(crate) request: FrameRequest,
    pub(crate) plan: FramePlan,
    /// What is written for the device already.
    pub(crate) staged: Option<StagedFrame>,
    /// Milliseconds that the planning took.
    pub(crate) plan_ms: f64,
}

impl FramePacket {
    /// Whether what the device needs of the scene is written to where it copies from ([`FramePlanner::plan_and_stage`]).
    #[must_use]
    pub const fn is_staged(&self) -> bool {
        self.staged.is_some()
    }
}
