//! From a scene to a frame.
//!
//! A frame is planned (`frame_packet`), uploaded (`scene_buffers`), recorded (`Renderer::record_frame`: shadows, visibility,
//! lighting, resolve, readback, in one function), and post-processed (`raw_frame`). The first and the last step need no device and
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
mod raster;
mod raw_frame;
pub mod resolve;
mod scene_buffers;
pub mod select;
mod settings;
pub mod shadow;
mod slots;
mod staged_frame;
mod tiling;
#[cfg(test)]
mod unwritten;
pub mod visibility;

use std::sync::Arc;
use std::time::Instant;

use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::gpu::Gpu;
use crate::gpu::staging::StagingBuffers;
use crate::gpu::upload::UploadPool;
use crate::scene::Scene;
pub use backend::{LightingMode, RasterBackend, RasterMode, RasterOptions};
pub use device::timing::StageTimes;
pub use frame_packet::{FramePacket, FramePlanner, Staging};
pub use raw_frame::{FrameCost, InFlight, RawFrame};
pub use settings::{DEFAULT_TEXTURE_PX, RenderSettings};

use device::bind_groups::BindLayouts;
use device::timing::{Pass, add_times, milliseconds};
use frame_packet::FrameRequest;
use frame_plan::{FramePlan, uniforms};
use lighting::gbuffer::{GBuffer, GBufferPool};
use lighting::{frame_key::FrameKey, pass::LightingPass};
use resolve::pass::ResolvePass;
use scene_buffers::SceneBuffers;
use select::tiles::ImageTile;
use shadow::ShadowBackend;
use slots::{Slot, SlotPool, Submission, TileSubmission};
use staged_frame::StagedFrame;
use tiling::{TileLimits, TiledFrame};
use visibility::{VisibilityBackend, VisibilityInputs};

/// Frames in flight that keep a device and the threads that feed it busy: one is rendered while the next is prepared.
pub const FRAMES_IN_FLIGHT: usize = 2;

/// A frame that is ready to be recorded.
#[derive(Debug)]
struct PreparedFrame {
    plan: FramePlan,
    /// What is copied to the device with the first tile.
    staged: Option<StagedFrame>,
    /// One, or those that the frame is drawn in. The first is prepared.
    tiles: Vec<ImageTile>,
    gbuffer: GBuffer,
    slot: Slot,
    pipelines: FrameKey,
    uploaded_bytes: u64,
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
    /// Those of [`Self::with_raster`].
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
            planner: Arc::new(FramePlanner::new(raster, UploadPool::new(&gpu.device))),
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
            self.planner = Arc::new(self.planner.with_options(raster));
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

    /// Submits a frame that [`Self::planner`] planned of `scene`, since the last [`Self::set_raster`], behind those that the device works
    /// on, and does not wait for it, unless it is so large that it is drawn in tiles.
    ///
    /// # Errors
    /// [`Error::SizeBeyondDevice`], [`Error::DeviceLost`] or [`Error::Device`].
    pub fn submit_packet(&mut self, scene: &Scene, packet: FramePacket) -> Result<InFlight> {
        let submitted = if self.raster.uses_host() {
            // The host backends share their work out to the pool.
            rayon::scope(|_| self.try_submit(scene, packet))
        } else {
            self.try_submit(scene, packet)
        };
        submitted.inspect_err(|error| self.start_over(error))
    }

    /// After an error nobody knows what the device holds, and what it had no memory for stays unusable: the next frame makes all of it
    /// again.
    fn start_over(&mut self, error: &Error) {
        // Nothing was made for a frame that is too large.
        if matches!(error, Error::SizeBeyondDevice { .. }) {
            return;
        }
        self.buffers = SceneBuffers::default();
        self.shadow = ShadowBackend::new(self.raster.shadow);
        if !matches!(error, Error::Unlabelled { .. }) {
            self.visibility = VisibilityBackend::new(&self.raster);
            self.lighting = LightingPass::new(&self.gpu, &self.layouts);
            self.resolve = ResolvePass::new(&self.gpu, &self.layouts);
            (self.gbuffers, self.slots) = Default::default();
            self.staging.clear();
        }
    }

    fn try_submit(&mut self, scene: &Scene, packet: FramePacket) -> Result<InFlight> {
        let start = Instant::now();
        let FramePacket { request, plan, staged, plan_ms } = packet;
        let frame = self.prepare(scene, &request, (plan, staged))?;
        self.submit_prepared(scene, request, frame, (start, plan_ms))
    }

    /// Records a frame whose preparation began at `start`, after this many milliseconds of planning, and submits it. A frame in tiles is
    /// drawn and read back.
    fn submit_prepared(
        &mut self,
        scene: &Scene,
        request: FrameRequest,
        mut frame: PreparedFrame,
        (start, plan_ms): (Instant, f64),
    ) -> Result<InFlight> {
        let host_ms: f64 = self.host_times().iter().map(|(_, ms)| ms).sum();
        let mut times = vec![("plan", plan_ms), ("upload", milliseconds(start.elapsed()) - host_ms)];
        let mut tile = self.submit_tile(&frame, true)?;
        let in_tiles = if frame.tiles.len() > 1 {
            let sizes = (request.rendered(scene).1, request.image.size);
            Some(self.draw_tiles(sizes, &mut frame, &mut tile)?)
        } else {
            None
        };
        times.extend(self.host_times());
        let PreparedFrame { gbuffer, slot, uploaded_bytes, tiles, .. } = frame;
        let packed_bytes = |tile: &ImageTile| tile.packed_bytes(request.image.annotations);
        let cost = FrameCost {
            drawn_triangles: self.visibility.triangles(&self.buffers.meshes, &gbuffer.batches),
            lighting_draws: self.raster.lighting.draws(gbuffer.batches.len()),
            uploaded_bytes,
            readback_bytes: tiles.iter().map(packed_bytes).sum(),
        };
        self.last_cost = cost;
        self.gbuffers.keep(gbuffer);
        let submission = match in_tiles {
            None => {
                times.push(("record", tile.record_ms));
                Submission::Whole(slot, tile)
            }
            Some((drawn, tile_times)) => {
                times.extend(tile_times);
                // Tiles of a large frame take all the memory that they may.
                if self.draws_small_tiles() {
                    self.slots.keep(slot);
                }
                Submission::InTiles(drawn)
            }
        };
        Ok(InFlight { request, submission, times, cost })
    }

    /// Times of the host backends.
    fn host_times(&self) -> StageTimes {
        let stages = [("shadow", self.shadow.host_ms()), ("visibility", self.visibility.host_ms())];
        stages.into_iter().filter_map(|(name, ms)| Some((name, ms?))).collect()
    }

    /// Whether a frame is drawn in small tiles: with a software adapter, whose memory is the process's, where no other frame could be drawn while
    /// this one is read back, and where the host rasterises the tiles, which then have every bit of the whole frame.
    fn draws_small_tiles(&self) -> bool {
        self.staging.device_is_idle
            && self.gpu.capabilities.software_adapter
            && self.raster.visibility == RasterBackend::Host
    }

    /// Draws the tiles of a frame, of which the first was submitted, one after the other; returns the frame, and the times of all its tiles.
    /// `settings` are those of the image before distortion.
    fn draw_tiles(
        &mut self,
        (settings, image_size): (&RenderSettings, [u32; 2]),
        frame: &mut PreparedFrame,
        tile: &mut TileSubmission,
    ) -> Result<(Frame, StageTimes)> {
        let mut whole = TiledFrame::new(image_size);
        let mut times = StageTimes::new();
        for number in 0..frame.tiles.len() {
            let drawn = frame.tiles[number];
            let read = frame.slot.read(&self.gpu, tile).map_err(|error| drawn.in_image(error));
            let (planes, tile_times) = read?;
            whole.add(drawn, &planes);
            add_times(&mut times, [("record", tile.record_ms)].into_iter().chain(tile_times));
            if let Some(&next) = frame.tiles.get(number + 1) {
                self.prepare_tile(settings, frame, next)?;
                *tile = self.submit_tile(frame, false)?;
            }
        }
        Ok((whole.finish(), times))
    }

    /// Records and submits a tile, the first of a frame with the frame's shadows.
    fn submit_tile(&self, frame: &PreparedFrame, is_first: bool) -> Result<TileSubmission> {
        let submitted = Instant::now();
        let index = self.gpu.guard(|| {
            let descriptor = wgpu::CommandEncoderDescriptor { label: Some("frame") };
            let mut encoder = self.gpu.device.create_command_encoder(&descriptor);
            self.record_frame(&mut encoder, frame, is_first);
            let index = self.gpu.queue.submit([encoder.finish()]);
            frame.slot.map();
            index
        })?;
        // Here an error is that of this frame; later, another in flight might be taken for the one that failed.
        self.gpu.check()?;
        let (record_ms, passes) = (milliseconds(submitted.elapsed()), self.device_passes(is_first));
        Ok(TileSubmission { index, submitted, record_ms, passes })
    }

    /// Uploads a plan, rasterises what is the host's part of its first tile, and compiles the pipelines that are missing.
    fn prepare(
        &mut self,
        scene: &Scene,
        request: &FrameRequest,
        (mut plan, mut staged): (FramePlan, Option<StagedFrame>),
    ) -> Result<PreparedFrame> {
        let (scene, settings) = request.rendered(scene);
        let layout = self.visibility.gbuffer_layout(scene);
        let limits = if self.draws_small_tiles() { self.tile_limits.small() } else { self.tile_limits };
        let rasteriser = self.raster.visibility;
        let tiles =
            tiling::tiles(&self.gpu, &request.image, (scene, settings), (layout, rasteriser), limits)?;
        let tile = tiles[0];
        let of_tile = RenderSettings { size: tile.rendered.size, ..*settings };
        let is_distorted = request.undistorted.is_some();
        let mut gbuffer = self.gbuffers.take(&self.gpu, (&of_tile, is_distorted), layout, limits.bytes);
        let mut slot = self.slots.take(&self.gpu, &RenderSettings { size: tile.image.size, ..request.image });
        let pipelines = FrameKey::new(scene, &gbuffer);
        gbuffer.is_distorted = is_distorted;
        gbuffer.has_rgb = scene.sensor.is_none();
        let resolve_variant = resolve::pass::Variant::new(&gbuffer);
        // Compiling a pipeline takes longer than it saves in one frame: the first is lit by as few pipelines as possible, which are
        // compiled while it is prepared.
        let is_first = !self.lighting.has(pipelines, self.raster.lighting);
        let mut raster = self.raster;
        raster.bin_by_shadow_sources &= !is_first;
        let Self { gpu, layouts, buffers, shadow, visibility, lighting, resolve, staging, .. } = self;
        let prepare = || {
            plan.place_tiles(|selection| shadow.place_tiles(scene, selection, raster.max_texture_px));
            plan.uniforms = uniforms::of_tile(&plan.uniforms, tile, settings);
            let multi_draw = raster.multi_draw;
            let to_upload = (&plan, staged.as_mut());
            let mut bytes = gpu.guard(|| buffers.upload(gpu, scene, to_upload, (multi_draw, staging)))??;
            let full_sun = plan.horizon.full_sun().filter(|_| raster.bin_by_shadow_sources);
            // Nothing else needs these.
            (plan.horizon, plan.instances, plan.lit_rocks) = Default::default();
            let of_map = (scene, plan.map_source.take(), plan.shadow_map_px);
            let casters = (&buffers.meshes, &plan.draws.casters);
            bytes += shadow.prepare(gpu, layouts, of_map, (casters, staging))?;
            let inputs = VisibilityInputs {
                scene,
                settings,
                selection: &plan.selection,
                caster_grid: &plan.caster_grid,
                bands: &plan.bands,
                draws: (&buffers.meshes, &plan.draws.batches),
                bin_by_shadow_sources: raster.bin_by_shadow_sources,
                full_sun: full_sun.as_ref(),
            };
            bytes += visibility.find(gpu, layouts, inputs)?;
            let samples = tile.rendered.samples(settings.samples_per_side);
            bytes += visibility.fill(gpu, &plan.draws.batches, samples, (&mut gbuffer, staging))?;
            Result::Ok((plan, staged, bytes))
        };
        let mut compile_resolve = || resolve.prepare(gpu, resolve_variant);
        let mut compile_lighting = || lighting.prepare_general(gpu, layouts, pipelines, raster.lighting);
        // Once there are pipelines, this thread neither wakes those of the pool nor waits for them.
        let (prepared, _) = if is_first {
            rayon::join(prepare, || rayon::join(compile_resolve, compile_lighting))
        } else {
            (prepare(), (compile_resolve(), compile_lighting()))
        };
        let (plan, staged, mut uploaded_bytes) = prepared?;
        uploaded_bytes += slot.packed.choose(gpu, &mut gbuffer);
        if raster.lighting == LightingMode::Bins {
            lighting.prepare(gpu, pipelines, gbuffer.batches.iter().map(|batch| batch.variant));
        }
        gpu.check()?;
        Ok(PreparedFrame { plan, staged, tiles, gbuffer, slot, pipelines, uploaded_bytes })
    }

    /// Prepares a further tile of a frame. `settings` are those of the image before distortion.
    fn prepare_tile(
        &mut self,
        settings: &RenderSettings,
        frame: &mut PreparedFrame,
        tile: ImageTile,
    ) -> Result<()> {
        let Self { gpu, buffers, visibility, lighting, staging, .. } = self;
        let PreparedFrame { plan, gbuffer, slot, pipelines, uploaded_bytes, .. } = frame;
        *uploaded_bytes += buffers.upload_uniforms(gpu, &uniforms::of_tile(&plan.uniforms, tile, settings));
        let samples = tile.rendered.samples(settings.samples_per_side);
        *uploaded_bytes += visibility.fill(gpu, &plan.draws.batches, samples, (gbuffer, staging))?;
        *uploaded_bytes += slot.packed.choose(gpu, gbuffer);
        if self.raster.lighting == LightingMode::Bins {
            lighting.prepare(gpu, *pipelines, gbuffer.batches.iter().map(|batch| batch.variant));
        }
        gpu.check()
    }

    /// The frame, or a tile of one: shadows with the first, visibility, lighting, resolve, readback.
    fn record_frame(&self, encoder: &mut wgpu::CommandEncoder, frame: &PreparedFrame, is_first: bool) {
        let PreparedFrame { plan, gbuffer, slot: Slot { packed, timer, .. }, pipelines, .. } = frame;
        let Self { gpu, layouts, buffers, .. } = self;
        let (meshes, timer) = (&buffers.meshes, timer.as_ref());
        let nearest = || wgpu::BindingResource::Sampler(&self.nearest);
        let groups = buffers.raster_groups(gpu, layouts);
        let of_light = buffers.light_group(gpu, layouts, gbuffer, self.shadow.map(), nearest());
        let of_resolve = ResolvePass::bind_group(gpu, layouts, (gbuffer, packed), nearest());
        if is_first {
            buffers.record_copies(encoder, frame.staged.as_ref());
            self.shadow.record(encoder, meshes, &plan.draws.casters, &groups, timer);
        }
        self.visibility.record(gpu, encoder, meshes, &groups, (gbuffer, timer));
        let light = [&groups.frame, &groups.scene, &of_light];
        self.lighting.record(gpu, encoder, light, (*pipelines, gbuffer), timer);
        let timestamps = timer.map(|timer| timer.compute_pass(Pass::Resolve));
        self.resolve.record(encoder, &groups.frame, &of_resolve, gbuffer, packed, timestamps);
        packed.copy(encoder);
        if let Some(timer) = timer {
            timer.copy(encoder, &self.device_passes(is_first));
        }
    }

    /// The passes of a tile that the device times: those of the shadows are drawn with the first.
    fn device_passes(&self, is_first: bool) -> Vec<Pass> {
        let raster = [self.shadow.device_pass().filter(|_| is_first), self.visibility.device_pass()];
        raster.into_iter().flatten().chain([Pass::Lighting, Pass::Resolve]).collect()
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
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`]; [`crate::Error::Unlabelled`] if a draw of it was lost.
    pub fn read_back(&mut self, in_flight: InFlight) -> Result<RawFrame> {
        let InFlight { request, submission, mut times, .. } = in_flight;
        let frame = match submission {
            Submission::InTiles(frame) => frame,
            Submission::Whole(slot, tile) => {
                let read = slot.read(&self.gpu, &tile).inspect_err(|error| self.start_over(error));
                let (frame, device_times) = read?;
                times.extend(device_times);
                self.slots.keep(slot);
                frame
            }
        };
        Ok(RawFrame { frame, request, times })
    }
}
