//! A planned frame on its way to the device and back: uploaded, recorded, submitted and read, whole or tile by tile.
//! Must not know: how a stage works.

use std::time::Instant;

use crate::error::Result;
use crate::frame::Frame;
use crate::render::device::bind_groups::bind_group;
use crate::render::device::shading_bins::LightingVariant;
use crate::render::device::timing::{Pass, StageTimes, milliseconds};
use crate::render::frame_packet::FrameRequest;
use crate::render::frame_plan::{self, FramePlan};
use crate::render::lighting::gbuffer::GBuffer;
use crate::render::lighting::pass::FrameKey;
use crate::render::resolve::{self, pass::PackedFrame};
use crate::render::select::tiles::ImageTile;
use crate::render::slots::Slot;
use crate::render::tiling::{self, TiledFrame};
use crate::render::visibility::VisibilityInputs;
use crate::render::{
    FrameCost, InFlight, LightingMode, RasterBackend, RasterOptions, RenderSettings, Renderer,
};
use crate::scene::Scene;

/// A frame that is ready to be recorded.
#[derive(Debug)]
pub(super) struct PreparedFrame {
    plan: FramePlan,
    /// One, or those that the frame is drawn in. The first is prepared.
    tiles: Vec<ImageTile>,
    pub(super) gbuffer: GBuffer,
    slot: Slot,
    pipelines: FrameKey,
    uploaded_bytes: u64,
}

/// A frame that was submitted.
#[derive(Debug)]
pub(super) enum Submitted {
    /// The device draws it.
    Whole(Slot, SubmittedTile),
    /// It was drawn in tiles, which are read back already.
    InTiles(Frame),
}

/// A tile, or a whole frame, that the device draws.
#[derive(Debug)]
pub(super) struct SubmittedTile {
    submission: wgpu::SubmissionIndex,
    submitted: Instant,
    record_ms: f64,
    /// Passes that the device times.
    passes: Vec<Pass>,
}

impl Renderer {
    /// Records a frame whose preparation began at `start`, after this many milliseconds of planning, and submits it. A frame in tiles is
    /// drawn and read back.
    pub(super) fn submit_prepared(
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
        let PreparedFrame { gbuffer, slot, uploaded_bytes, .. } = frame;
        let cost = FrameCost {
            drawn_triangles: self.visibility.triangles(&self.buffers.meshes, &gbuffer.batches),
            lighting_draws: self.raster.lighting.draws(gbuffer.batches.len()),
            uploaded_bytes,
        };
        self.last_cost = cost;
        self.gbuffers.keep(gbuffer);
        let submitted = match in_tiles {
            None => {
                times.push(("record", tile.record_ms));
                Submitted::Whole(slot, tile)
            }
            Some((drawn, tile_times)) => {
                times.extend(tile_times);
                // Tiles of a large frame take all the memory that they may.
                if self.draws_small_tiles() {
                    self.slots.keep(slot);
                }
                Submitted::InTiles(drawn)
            }
        };
        Ok(InFlight { request, submitted, times, cost })
    }

    /// Times of the host backends.
    fn host_times(&self) -> StageTimes {
        let stages = [("shadow", self.shadow.host_ms()), ("visibility", self.visibility.host_ms())];
        stages.into_iter().filter_map(|(name, ms)| Some((name, ms?))).collect()
    }

    /// Whether a frame is drawn in small tiles: with a CPU driver, whose memory is the process's, where no other frame could be drawn while
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
        tile: &mut SubmittedTile,
    ) -> Result<(Frame, StageTimes)> {
        let mut whole = TiledFrame::new(image_size);
        let mut times = StageTimes::new();
        for number in 0..frame.tiles.len() {
            let drawn = frame.tiles[number];
            let read = self.read_tile(&frame.slot, tile).map_err(|error| drawn.in_image(error));
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
    fn submit_tile(&self, frame: &PreparedFrame, is_first: bool) -> Result<SubmittedTile> {
        let submitted = Instant::now();
        let submission = self.gpu.guard(|| {
            let descriptor = wgpu::CommandEncoderDescriptor { label: Some("frame") };
            let mut encoder = self.gpu.device.create_command_encoder(&descriptor);
            self.record_frame(&mut encoder, frame, is_first);
            let submission = self.gpu.queue.submit([encoder.finish()]);
            frame.slot.map();
            submission
        })?;
        let (record_ms, passes) = (milliseconds(submitted.elapsed()), self.device_passes(is_first));
        Ok(SubmittedTile { submission, submitted, record_ms, passes })
    }

    /// Waits for a tile that was submitted and reads it back, with the times of this and of the device's passes.
    pub(super) fn read_tile(&self, slot: &Slot, tile: &SubmittedTile) -> Result<(Frame, StageTimes)> {
        self.gpu.wait(&tile.submission)?;
        let done = Instant::now();
        let planes = slot.packed.read()?;
        let read = Instant::now();
        let mut times = match &slot.timer {
            Some(timer) => timer.read(&self.gpu, &tile.passes)?,
            None => StageTimes::new(),
        };
        let gpu_ms = milliseconds(done - tile.submitted);
        times.extend([("gpu", gpu_ms), ("readback", milliseconds(read - done))]);
        Ok((planes, times))
    }

    /// Uploads a plan, rasterises what is the host's part of its first tile, and compiles the pipelines that are missing.
    pub(super) fn prepare(
        &mut self,
        scene: &Scene,
        request: &FrameRequest,
        mut plan: FramePlan,
    ) -> Result<PreparedFrame> {
        let (scene, settings) = request.rendered(scene);
        let layout = self.visibility.gbuffer_layout(scene);
        let limits = if self.draws_small_tiles() { self.tile_limits.small() } else { self.tile_limits };
        let tiles = tiling::tiles(&self.gpu, &request.image, (scene, settings), layout, limits)?;
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
        let is_first = !self.lighting.has(pipelines);
        let raster = RasterOptions {
            bin_by_shadow_sources: self.raster.bin_by_shadow_sources && !is_first,
            ..self.raster
        };
        let Self { gpu, layouts, buffers, shadow, visibility, lighting, resolve, staging, .. } = self;
        let (prepared, ()) = rayon::join(
            || {
                plan.place_tiles(|selection| shadow.place_tiles(scene, selection));
                plan.uniforms = frame_plan::of_tile(&plan.uniforms, tile, settings);
                let multi_draw = raster.multi_draw;
                let mut bytes = gpu.guard(|| buffers.upload(gpu, scene, &plan, (multi_draw, staging)))??;
                // Nothing else needs these.
                (plan.horizon, plan.instances, plan.lit_rocks) = Default::default();
                let size_px = plan.shadow_map_px;
                bytes += shadow.prepare(gpu, layouts, (scene, &plan.selection, size_px), staging)?;
                let inputs = VisibilityInputs {
                    scene,
                    settings,
                    selection: &plan.selection,
                    caster_grid: &plan.caster_grid,
                    bands: &plan.bands,
                    bin_by_shadow_sources: raster.bin_by_shadow_sources,
                };
                visibility.find(gpu, layouts, inputs);
                let samples = tile.rendered.samples(settings.samples_per_side);
                bytes += visibility.fill(gpu, &plan.draws.batches, samples, (&mut gbuffer, staging))?;
                Result::Ok((plan, bytes))
            },
            || {
                resolve.prepare(gpu, resolve_variant);
                match raster.lighting {
                    LightingMode::Bins if is_first => {
                        lighting.prepare(gpu, pipelines, LightingVariant::GENERAL);
                    }
                    LightingMode::OneDraw => lighting.prepare(gpu, pipelines, [LightingVariant::Any]),
                    LightingMode::Bins => {}
                }
            },
        );
        let (plan, mut uploaded_bytes) = prepared?;
        uploaded_bytes += slot.packed.choose(gpu, &mut gbuffer);
        if raster.lighting == LightingMode::Bins {
            lighting.prepare(gpu, pipelines, gbuffer.batches.iter().map(|batch| batch.variant));
        }
        gpu.check()?;
        Ok(PreparedFrame { plan, tiles, gbuffer, slot, pipelines, uploaded_bytes })
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
        *uploaded_bytes += buffers.upload_uniforms(gpu, &frame_plan::of_tile(&plan.uniforms, tile, settings));
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
        let (meshes, timer) = (&self.buffers.meshes, timer.as_ref());
        let groups = self.bind_groups(gbuffer, packed);
        let drawing = [&groups.frame, &groups.scene];
        if is_first {
            self.shadow.record(encoder, meshes, &plan.draws.casters, drawing, timer);
        }
        self.visibility.record(encoder, meshes, drawing, gbuffer, timer);
        let light = [&groups.frame, &groups.scene, &groups.light];
        let timestamps = timer.map(|timer| timer.render_pass(Pass::Lighting));
        self.lighting.record(encoder, light, *pipelines, gbuffer, timestamps);
        let timestamps = timer.map(|timer| timer.compute_pass(Pass::Resolve));
        self.resolve.record(encoder, &groups.frame, &groups.resolve, gbuffer, packed, timestamps);
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

    fn bind_groups(&self, gbuffer: &GBuffer, packed: &PackedFrame) -> BindGroups {
        let Self { gpu, layouts, buffers, .. } = self;
        let view = wgpu::BindingResource::TextureView;
        let nearest = wgpu::BindingResource::Sampler(&self.nearest);
        let resolve = [
            view(&gbuffer.visibility.1),
            packed.buffer.as_entire_binding(),
            nearest.clone(),
            packed.tile_list.as_entire_binding(),
        ];
        let resolve: Vec<_> = resolve.into_iter().chain(gbuffer.planes.iter().map(view)).collect();
        BindGroups {
            frame: buffers.frame_group(gpu, layouts),
            scene: buffers.scene_group(gpu, layouts),
            light: buffers.light_group(gpu, layouts, gbuffer, self.shadow.map(), nearest),
            resolve: bind_group(gpu, "resolve", &layouts.resolve, &resolve),
        }
    }
}

/// Adds the times of a tile to those of others.
fn add_times(sum: &mut StageTimes, times: impl IntoIterator<Item = (&'static str, f64)>) {
    for (stage, ms) in times {
        match sum.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, of_stage)) => *of_stage += ms,
            None => sum.push((stage, ms)),
        }
    }
}

struct BindGroups {
    frame: wgpu::BindGroup,
    scene: wgpu::BindGroup,
    light: wgpu::BindGroup,
    resolve: wgpu::BindGroup,
}
