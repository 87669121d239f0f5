//! From a scene to a frame.
//!
//! [`Renderer`] holds what lasts: pipelines, G-buffer, buffers. A frame is [`Renderer::record_frame`]: shadow
//! atlas, visibility, lighting pass, resolve, copy, in one function.
//! Must not know: knobs, files.
//! To add a pass: a file here with its struct (`new`, `record`), its WGSL in `shaders.rs`, a line in
//! [`Renderer::record_frame`].

pub mod device;
pub mod gpu_scene;
pub mod lighting;
pub mod post;
pub mod raster;
pub mod resolve;
pub mod select;
mod settings;
pub mod shadow;
pub mod visibility;

use std::time::Instant;

use crate::error::Result;
use crate::frame::{Annotation, Annotations, Frame};
use crate::gpu::Gpu;
use crate::gpu::staging::StagingBuffer;
use crate::scene::Scene;
pub use device::timing::StageTimes;
pub use settings::RenderSettings;

use device::bind_groups::BindLayouts;
use device::shader_structs::{Instance, ReliefUniforms};
use device::shading_bins::LightingVariant;
use device::timing::{Pass, Timer, milliseconds};
use gpu_scene::{DrawnHere, GpuScene, Ways};
use lighting::gbuffer::GBuffer;
use lighting::pass::{LightingPass, Variant};
use resolve::pass::{PackedFrame, ResolvePass};
use shadow::device::ShadowPass;
use visibility::device::VisibilityPass;

/// What a frame comes back in.
#[derive(Debug)]
struct Slot {
    packed: PackedFrame,
    /// What the device is given of the shadow map and of what samples show, if it is.
    given_shadow_map: Option<StagingBuffer>,
    given_visible: Option<StagingBuffer>,
    timer: Option<Timer>,
}

/// Frames in flight that keep a device and the threads that feed it busy: it draws one while the next is made ready.
pub const FRAMES_IN_FLIGHT: usize = 2;

/// A frame that the device works on: from [`Renderer::submit`] to [`Renderer::finish`].
#[derive(Debug)]
pub struct InFlight {
    asked: Annotations,
    picture: RenderSettings,
    /// Of a lens: what is drawn instead.
    wide: Option<(Scene, RenderSettings)>,
    slot: Slot,
    submission: wgpu::SubmissionIndex,
    upload_ms: f64,
    /// What this program drew of it.
    drawn_here: DrawnHere,
    uploaded: Instant,
    /// Triangles drawn of what is seen in it.
    pub drawn_triangles: u64,
    /// Bytes that were written to the device for it.
    pub uploaded_bytes: u64,
}

/// Renders scenes on one device.
#[derive(Debug)]
pub struct Renderer {
    gpu: Gpu,
    layouts: BindLayouts,
    /// Takes texels as they are.
    nearest: wgpu::Sampler,
    shadow_pass: ShadowPass,
    visibility_pass: VisibilityPass,
    lighting_pass: LightingPass,
    resolve_pass: ResolvePass,
    scene: GpuScene,
    gbuffer: Option<GBuffer>,
    /// What frames that are not in flight any more came back in.
    spare: Vec<Slot>,
    /// What this program does itself; labels are the same either way. At first all of it if the device is a CPU, else nothing: a
    /// GPU is faster without.
    pub ways: Ways,
}

impl Renderer {
    /// Compiles everything on a device.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn new(gpu: Gpu) -> Result<Self> {
        let layouts = BindLayouts::new(&gpu);
        let renderer = Self {
            nearest: gpu
                .device
                .create_sampler(&wgpu::SamplerDescriptor { label: Some("nearest"), ..Default::default() }),
            shadow_pass: ShadowPass::default(),
            visibility_pass: VisibilityPass::default(),
            lighting_pass: LightingPass::new(&gpu, &layouts),
            resolve_pass: ResolvePass::new(&gpu, &layouts),
            scene: GpuScene::default(),
            gbuffer: None,
            spare: Vec::new(),
            ways: Ways {
                own_shadow_map: gpu.capabilities.software_adapter,
                own_visibility: gpu.capabilities.software_adapter && gpu.capabilities.stencil_upload,
                by_shades: true,
                multi_draw: gpu.capabilities.multi_draw,
            },
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

    /// What was drawn last.
    #[must_use]
    pub const fn gpu_scene(&self) -> &GpuScene {
        &self.scene
    }

    /// Renders one frame and waits for it.
    ///
    /// # Errors
    /// [`Error::SizeBeyondDevice`], [`Error::DeviceLost`] or [`Error::Device`].
    pub fn render(&mut self, scene: &Scene, settings: &RenderSettings) -> Result<(Frame, StageTimes)> {
        let in_flight = self.submit(scene, settings)?;
        self.finish(in_flight, scene)
    }

    /// Sets the device to work on a frame, after those that it works on, and does not wait for it.
    ///
    /// # Errors
    /// [`Error::SizeBeyondDevice`], [`Error::DeviceLost`] or [`Error::Device`]; those of [`select::near_plane::checked`].
    pub fn submit(&mut self, scene: &Scene, settings: &RenderSettings) -> Result<InFlight> {
        // On a thread of the pool: from any other each part that many threads share would first have to be taken by one of them.
        rayon::scope(|_| self.try_submit(scene, settings)).inspect_err(|_| self.scene.forget())
    }

    fn try_submit(&mut self, scene: &Scene, settings: &RenderSettings) -> Result<InFlight> {
        let start = Instant::now();
        let asked = settings.annotations;
        let mut picture = *settings;
        picture.annotations = post::hazards::drawn_for(asked);
        if scene.sensor.is_some() {
            picture.annotations = picture.annotations.with(Annotation::Hdr);
        }
        // What a lens brings onto the picture is drawn as a wider one without it, of which the resolve takes the samples.
        let (camera, size) = select::near_plane::checked(scene, picture.size)?;
        let wide = (!camera.lens.is_pinhole())
            .then(|| (Scene { camera, ..scene.clone() }, RenderSettings { size, ..picture }));
        let (scene, drawn) = wide.as_ref().map_or((scene, &picture), |(scene, drawn)| (scene, drawn));
        let is_given = self.ways.own_visibility;
        let has_slopes = is_given && scene.relief.is_some();
        let mut gbuffer = match self.gbuffer.take() {
            Some(kept) if kept.serve(drawn, is_given, has_slopes) => kept,
            _ => GBuffer::new(&self.gpu, drawn, is_given, has_slopes)?,
        };
        self.spare.retain(|slot| slot.packed.serves(picture.size, picture.annotations));
        let mut slot = self.spare.pop().unwrap_or_else(|| Slot {
            packed: PackedFrame::new(&self.gpu, picture.size, picture.annotations),
            given_shadow_map: None,
            given_visible: None,
            timer: Timer::new(&self.gpu),
        });
        // A program takes longer to compile than it saves in a frame: the first is lit by as few as can be, which are compiled while
        // it is made ready.
        let variant = Variant::new(scene, &gbuffer);
        let is_first = !self.lighting_pass.has(variant);
        let ways = Ways { by_shades: self.ways.by_shades && !is_first, ..self.ways };
        let Self { gpu, layouts, scene: gpu_scene, shadow_pass, lighting_pass, resolve_pass, .. } = self;
        let resolved = resolve::pass::Variant::new(&gbuffer, slot.packed.size);
        let (made_ready, ()) = rayon::join(
            || {
                gpu.guard(|| gpu_scene.upload(gpu, scene, drawn, picture.size, ways))?;
                shadow_pass.prepare(gpu, layouts, gpu_scene.atlas_px, ways.own_shadow_map);
                gpu_scene.give_shadow_map(gpu, scene, shadow_pass, &mut slot.given_shadow_map)?;
                gpu_scene.give_visible(gpu, scene, &mut gbuffer, &mut slot.given_visible)
            },
            || {
                resolve_pass.prepare(gpu, resolved);
                if is_first {
                    lighting_pass.prepare(gpu, variant, LightingVariant::BY_ANYTHING);
                }
            },
        );
        made_ready?;
        let shown = self.scene.shown(&gbuffer);
        self.scene.uploaded_bytes += slot.packed.choose(&self.gpu, &gbuffer, shown);
        self.lighting_pass.prepare(&self.gpu, variant, self.scene.draws.batches.iter().map(|seen| seen.lit));
        if !gbuffer.is_given {
            self.visibility_pass.prepare(&self.gpu, &self.layouts);
        }
        self.gpu.check()?;
        let uploaded = Instant::now();
        let submission = self.gpu.guard(|| self.submit_frame(variant, &gbuffer, &slot))?;
        self.gbuffer = Some(gbuffer);
        let DrawnHere { shadow_map_ms, visibility_ms } = self.scene.drawn_here;
        Ok(InFlight {
            asked,
            picture,
            wide,
            slot,
            submission,
            upload_ms: milliseconds(uploaded - start)
                - shadow_map_ms.unwrap_or_default()
                - visibility_ms.unwrap_or_default(),
            drawn_here: self.scene.drawn_here,
            uploaded,
            drawn_triangles: self.scene.drawn_triangles,
            uploaded_bytes: self.scene.uploaded_bytes,
        })
    }

    /// Waits for a frame of `scene` that was submitted. Frames may be finished in any order.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn finish(&mut self, in_flight: InFlight, scene: &Scene) -> Result<(Frame, StageTimes)> {
        let InFlight { asked, picture, wide, slot, submission, upload_ms, drawn_here, uploaded, .. } =
            in_flight;
        let (drawn_scene, drawn) = wide.as_ref().map_or((scene, &picture), |(scene, drawn)| (scene, drawn));
        self.gpu.wait(&submission)?;
        let done = Instant::now();
        let mut frame = slot.packed.read(&self.gpu, &submission)?;
        frame.focal_px = drawn_scene.camera.focal_px(drawn.size[0]);
        frame.lens = drawn_scene.camera.lens;
        let read = Instant::now();
        let mut times = vec![("upload", upload_ms)];
        times.extend(drawn_here.shadow_map_ms.map(|ms| ("shadow", ms)));
        times.extend(drawn_here.visibility_ms.map(|ms| ("visibility", ms)));
        if let Some(timer) = &slot.timer {
            times.extend(timer.read(&self.gpu, &submission, by_device(drawn_here))?);
        }
        times.extend([("gpu", milliseconds(done - uploaded)), ("readback", milliseconds(read - done))]);
        self.spare.push(slot);
        let mut timed = |stage, work: &mut dyn FnMut(&mut Frame)| {
            let start = Instant::now();
            work(&mut frame);
            times.push((stage, milliseconds(start.elapsed())));
        };
        if drawn.annotations.contains(Annotation::Instances) {
            timed("labels", &mut |frame| {
                frame.rocks = post::rock_labels::rocks(drawn_scene, drawn, picture.size, frame);
            });
        }
        if let Some(sensor) = &scene.sensor {
            timed("sensor", &mut |frame| {
                post::sensor::expose(frame, sensor, scene.camera.exposure_ev);
                if !asked.contains(Annotation::Hdr) {
                    frame.radiance = Vec::new();
                }
            });
        }
        if post::hazards::any(asked) {
            timed("hazards", &mut |frame| post::hazards::add(frame, scene, asked));
        }
        Ok((frame, times))
    }

    fn submit_frame(&self, variant: Variant, gbuffer: &GBuffer, slot: &Slot) -> wgpu::SubmissionIndex {
        let mut encoder =
            self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        self.record_frame(&mut encoder, variant, gbuffer, slot);
        self.gpu.queue.submit([encoder.finish()])
    }

    /// The frame: shadow atlas, what is seen, light on it, resolve, copy.
    fn record_frame(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        variant: Variant,
        gbuffer: &GBuffer,
        slot: &Slot,
    ) {
        let (packed, timer) = (&slot.packed, slot.timer.as_ref());
        let groups = self.bind_groups(gbuffer, packed);
        self.shadow_pass.record(
            encoder,
            &self.scene,
            [&groups.frame, &groups.scene],
            timer.map(|timer| timer.both_passes(Pass::Shadow)),
        );
        if !gbuffer.is_given {
            self.visibility_pass.record(
                encoder,
                &self.scene,
                [&groups.frame, &groups.scene],
                gbuffer,
                timer.map(|timer| timer.render_pass(Pass::Visibility)),
            );
        }
        self.lighting_pass.record(
            encoder,
            &self.scene,
            [&groups.frame, &groups.scene, &groups.light],
            variant,
            gbuffer,
            timer.map(|timer| timer.render_pass(Pass::Lighting)),
        );
        self.resolve_pass.record(
            encoder,
            &groups.frame,
            &groups.resolve,
            gbuffer,
            packed,
            timer.map(|timer| timer.compute_pass(Pass::Resolve)),
        );
        packed.copy(encoder);
        if let Some(timer) = timer {
            timer.copy(encoder, by_device(self.scene.drawn_here));
        }
    }

    fn bind_groups(&self, gbuffer: &GBuffer, packed: &PackedFrame) -> BindGroups {
        let scene = &self.scene;
        let horizon = &scene.horizon.as_ref().expect("a scene is uploaded before it is drawn").1;
        let group = |label, layout: &wgpu::BindGroupLayout, resources: &[wgpu::BindingResource<'_>]| {
            let entries: Vec<_> = (0..)
                .zip(resources)
                .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
                .collect();
            self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(label),
                layout,
                entries: &entries,
            })
        };
        let view = wgpu::BindingResource::TextureView;
        BindGroups {
            frame: group("frame", &self.layouts.frame, &[scene.frame.buffer().as_entire_binding()]),
            scene: group(
                "scene",
                &self.layouts.scene,
                &[
                    scene.instances.bind_first(size_of::<Instance>()),
                    scene.tiles.buffer().as_entire_binding(),
                    scene.relief.bind_first(size_of::<ReliefUniforms>()),
                    scene.instances.buffer().as_entire_binding(),
                ],
            ),
            light: group(
                "light",
                &self.layouts.light,
                &[
                    view(&gbuffer.visibility.1),
                    view(self.shadow_pass.map()),
                    view(horizon),
                    scene.caster_grid.buffer().as_entire_binding(),
                    wgpu::BindingResource::Sampler(&self.nearest),
                    view(&gbuffer.slopes.1),
                ],
            ),
            resolve: group("resolve", &self.layouts.resolve, &{
                let planes = gbuffer.planes.iter().chain([&gbuffer.visibility.1]).map(view);
                let own = [
                    packed.buffer.as_entire_binding(),
                    wgpu::BindingResource::Sampler(&self.nearest),
                    packed.list.as_entire_binding(),
                ];
                planes.chain(own).collect::<Vec<_>>()
            }),
        }
    }
}

struct BindGroups {
    frame: wgpu::BindGroup,
    scene: wgpu::BindGroup,
    light: wgpu::BindGroup,
    resolve: wgpu::BindGroup,
}

/// Tells of each pass whether the device is given it, and not this program.
fn by_device(drawn_here: DrawnHere) -> impl Fn(Pass) -> bool {
    move |pass| match pass {
        Pass::Shadow => drawn_here.shadow_map_ms.is_none(),
        Pass::Visibility => drawn_here.visibility_ms.is_none(),
        Pass::Lighting | Pass::Resolve => true,
    }
}
