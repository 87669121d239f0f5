//! From a scene to a frame.
//!
//! A frame is planned (`frame_packet`), uploaded (`scene_buffers`), recorded (`prepared_frame`: shadows, visibility, lighting,
//! resolve, readback, in one function), and post-processed (`raw_frame`). The first and the last step need no device and
//! run on any thread; the thread that owns the [`Renderer`] does what lies between. Whether the device or the host rasterises
//! shadows and visibility is chosen once, in [`Renderer::with_raster`].
//! Must not know: knobs, files.
//! To add a pass: a file in the folder of its stage with its struct (`new`, `record`), its WGSL in `shaders/`, a line in
//! `Renderer::record_frame`.

mod backend;
pub mod device;
#[cfg(test)]
mod fallbacks;
mod frame_packet;
mod frame_plan;
pub mod lighting;
pub mod post;
mod prepared_frame;
mod raster;
mod raw_frame;
pub mod resolve;
mod scene_buffers;
pub mod select;
mod settings;
pub mod shadow;
mod slots;
mod tiling;
#[cfg(test)]
mod unwritten;
pub mod visibility;

use std::sync::Arc;
use std::time::Instant;

use crate::error::Result;
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::gpu::staging::StagingBuffers;
use crate::scene::Scene;
pub use backend::{LightingMode, RasterBackend, RasterMode, RasterOptions};
pub use device::timing::StageTimes;
pub use frame_packet::{FramePacket, FramePlanner};
pub use raw_frame::{FrameCost, RawFrame};
pub use settings::RenderSettings;

use device::bind_groups::BindLayouts;
use frame_packet::FrameRequest;
use lighting::gbuffer::GBufferPool;
use lighting::pass::LightingPass;
use prepared_frame::Submitted;
use resolve::pass::ResolvePass;
use scene_buffers::SceneBuffers;
use shadow::ShadowBackend;
use slots::SlotPool;
use tiling::TileLimits;
use visibility::VisibilityBackend;

/// Frames in flight that keep a device and the threads that feed it busy: one is rendered while the next is prepared.
pub const FRAMES_IN_FLIGHT: usize = 2;

/// A frame that the device works on: from [`Renderer::submit`] to [`Renderer::finish`].
#[derive(Debug)]
pub struct InFlight {
    request: FrameRequest,
    submitted: Submitted,
    /// Times of the stages up to the submission.
    times: StageTimes,
    /// How much was drawn and uploaded for it.
    pub cost: FrameCost,
}

/// Renders scenes on one device.
#[derive(Debug)]
pub struct Renderer {
    gpu: Gpu,
    layouts: BindLayouts,
    nearest: wgpu::Sampler,
    raster: RasterOptions,
    shadow: ShadowBackend,
    visibility: VisibilityBackend,
    lighting: LightingPass,
    resolve: ResolvePass,
    buffers: SceneBuffers,
    planner: Arc<FramePlanner>,
    gbuffers: GBufferPool,
    slots: SlotPool,
    staging: StagingBuffers,
    last_cost: FrameCost,
    /// How large a frame may be that is drawn whole.
    tile_limits: TileLimits,
}

impl Renderer {
    /// A renderer that chooses by the device who rasterises ([`RasterMode::Auto`]).
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    ///
    /// [`Error::DeviceLost`]: crate::Error::DeviceLost
    /// [`Error::Device`]: crate::Error::Device
    pub fn new(gpu: Gpu) -> Result<Self> {
        Self::with_raster(gpu, RasterMode::Auto)
    }

    /// A renderer whose stages are rasterised as the mode says. Labels are the same either way, to within the rounding of vertex
    /// positions.
    ///
    /// # Errors
    /// [`Error::Usage`] for a mode that the device does not support; [`Error::DeviceLost`] or [`Error::Device`].
    ///
    /// [`Error::Usage`]: crate::Error::Usage
    /// [`Error::DeviceLost`]: crate::Error::DeviceLost
    /// [`Error::Device`]: crate::Error::Device
    pub fn with_raster(gpu: Gpu, mode: RasterMode) -> Result<Self> {
        let raster = RasterOptions::new(mode, &gpu)?;
        let layouts = BindLayouts::new(&gpu);
        let nearest = wgpu::SamplerDescriptor { label: Some("nearest"), ..Default::default() };
        let renderer = Self {
            nearest: gpu.device.create_sampler(&nearest),
            raster,
            shadow: ShadowBackend::new(raster.shadow),
            visibility: VisibilityBackend::new(&raster),
            lighting: LightingPass::new(&gpu, &layouts),
            resolve: ResolvePass::new(&gpu, &layouts),
            buffers: SceneBuffers::default(),
            planner: Arc::new(FramePlanner::new(raster)),
            gbuffers: GBufferPool::default(),
            slots: SlotPool::default(),
            staging: StagingBuffers::default(),
            last_cost: FrameCost::default(),
            tile_limits: TileLimits::of(&gpu),
            layouts,
            gpu,
        };
        renderer.gpu.check()?;
        Ok(renderer)
    }

    /// The device.
    #[must_use]
    pub const fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// How it rasterises.
    #[must_use]
    pub const fn raster(&self) -> RasterOptions {
        self.raster
    }

    /// Changes how it rasterises from the next frame on.
    pub fn set_raster(&mut self, raster: RasterOptions) {
        if raster.shadow != self.raster.shadow {
            self.shadow = ShadowBackend::new(raster.shadow);
        }
        let visibility = |raster: &RasterOptions| (raster.visibility, raster.lighting);
        if visibility(&raster) != visibility(&self.raster) {
            self.visibility = VisibilityBackend::new(&raster);
        }
        if raster != self.raster {
            self.planner = Arc::new(FramePlanner::new(raster));
        }
        self.raster = raster;
    }

    /// Tells it how many frames will be in flight at a time, [`FRAMES_IN_FLIGHT`] until then. With one, the device is idle while the next is
    /// prepared, which is then uploaded in parts that take less memory. No frame depends on it.
    pub const fn expect_in_flight(&mut self, frames: usize) {
        self.staging.device_is_idle = frames <= 1;
    }

    /// The planner of its frames, for threads that plan while this one submits. [`Self::set_raster`] replaces it.
    #[must_use]
    pub fn planner(&self) -> Arc<FramePlanner> {
        Arc::clone(&self.planner)
    }

    /// How much was drawn and uploaded for the frame that was submitted last.
    #[must_use]
    pub const fn last_cost(&self) -> FrameCost {
        self.last_cost
    }

    /// Renders one frame and waits for it.
    ///
    /// # Errors
    /// Those of [`Self::submit`] and [`Self::finish`].
    pub fn render(&mut self, scene: &Scene, settings: &RenderSettings) -> Result<(Frame, StageTimes)> {
        let in_flight = self.submit(scene, settings)?;
        self.finish(in_flight, scene)
    }

    /// Plans a frame and submits it to the device, behind those that it works on, and does not wait for it.
    ///
    /// # Errors
    /// Those of [`FramePlanner::plan`] and [`Self::submit_packet`].
    pub fn submit(&mut self, scene: &Scene, settings: &RenderSettings) -> Result<InFlight> {
        // On a thread of the pool: a job from any other thread would wait for one of the pool to take it up.
        rayon::scope(|_| {
            let packet = self.planner.plan(scene, settings)?;
            self.submit_packet(scene, packet)
        })
    }

    /// Submits a frame of `scene` that [`Self::planner`] planned, behind those that the device works on, and does not wait for it,
    /// unless it is so large that it is drawn in tiles.
    ///
    /// # Errors
    /// [`Error::SizeBeyondDevice`], [`Error::DeviceLost`] or [`Error::Device`].
    ///
    /// [`Error::SizeBeyondDevice`]: crate::Error::SizeBeyondDevice
    /// [`Error::DeviceLost`]: crate::Error::DeviceLost
    /// [`Error::Device`]: crate::Error::Device
    pub fn submit_packet(&mut self, scene: &Scene, packet: FramePacket) -> Result<InFlight> {
        let submitted = if self.raster.uses_host() {
            // The host backends share their work out to the pool.
            rayon::scope(|_| self.try_submit(scene, packet))
        } else {
            self.try_submit(scene, packet)
        };
        submitted.inspect_err(|_| {
            self.buffers.invalidate();
            self.shadow.invalidate();
        })
    }

    fn try_submit(&mut self, scene: &Scene, packet: FramePacket) -> Result<InFlight> {
        let start = Instant::now();
        let FramePacket { request, plan, plan_ms } = packet;
        let frame = self.prepare(scene, &request, plan)?;
        self.submit_prepared(scene, request, frame, (start, plan_ms))
    }

    /// Waits for a frame of `scene` that was submitted, and post-processes it. Frames may be finished in any order.
    ///
    /// # Errors
    /// Those of [`Self::read_back`].
    pub fn finish(&mut self, in_flight: InFlight, scene: &Scene) -> Result<(Frame, StageTimes)> {
        Ok(self.read_back(in_flight)?.post_process(scene))
    }

    /// Waits for a frame that was submitted, and reads it back. Frames may be read back in any order.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`]; [`Error::Unlabelled`] if a draw of it was lost.
    ///
    /// [`Error::Unlabelled`]: crate::Error::Unlabelled
    /// [`Error::DeviceLost`]: crate::Error::DeviceLost
    /// [`Error::Device`]: crate::Error::Device
    pub fn read_back(&mut self, in_flight: InFlight) -> Result<RawFrame> {
        let InFlight { request, submitted, mut times, .. } = in_flight;
        let frame = match submitted {
            Submitted::InTiles(frame) => frame,
            Submitted::Whole(slot, tile) => {
                let (frame, device_times) = self.read_tile(&slot, &tile)?;
                times.extend(device_times);
                self.slots.keep(slot);
                frame
            }
        };
        Ok(RawFrame { frame, request, times })
    }
}
