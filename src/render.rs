//! From a scene to a frame.
//!
//! [`Renderer`] holds what lasts: pipelines, targets, buffers. A frame is [`Renderer::record_frame`]: shadow
//! atlas, scene pass, resolve, copy, in one function.
//! Must not know: knobs, files.
//! To add a pass: a file here with its struct (`new`, `record`), its WGSL in `shaders.rs`, a line in
//! [`Renderer::record_frame`].

pub mod facing;
pub mod gpu_scene;
pub mod hazards;
pub mod horizon;
mod labels;
pub mod resolve;
mod scene_pass;
pub mod selection;
pub mod sensor;
pub mod shaders;
pub mod shadow;
mod shadow_pass;
pub mod targets;
mod timing;

use std::time::Instant;

use wgpu::{BindingType, ShaderStages, TextureSampleType};

use crate::error::{Error, Result};
use crate::frame::{Annotation, Annotations, Frame};
use crate::gpu::Gpu;
use crate::scene::Scene;
use crate::scene::mesh::Vertex;
use gpu_scene::{Draw, GpuScene};
use resolve::{PackedFrame, ResolvePass};
use scene_pass::ScenePass;
use shadow_pass::ShadowPass;
use targets::Targets;
use timing::Timer;

/// What concerns the picture but not the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Samples along a side of a pixel: 1, 2 or 4.
    pub samples_per_side: u32,
    /// How far a rock may be drawn off its authored outline, pixels; 0 draws every triangle.
    pub outline_error_px: f32,
    /// What is wanted besides colour and class.
    pub annotations: Annotations,
}

/// The scene's specification allows less than a quarter of a pixel.
const OUTLINE_ERROR_PX: f32 = 0.24;

impl RenderSettings {
    /// Settings from a number of samples per pixel.
    ///
    /// # Errors
    /// [`Error::Usage`] unless `samples` is 1, 4 or 16 and both sides are at least a pixel.
    pub fn new(size: [u32; 2], samples: u32) -> Result<Self> {
        let [width, height] = size;
        if width == 0 || height == 0 {
            return Err(Error::Usage(format!(
                "--size {width}x{height}: a picture has at least one pixel each way"
            )));
        }
        match samples {
            1 | 4 | 16 => Ok(Self {
                size,
                samples_per_side: samples.isqrt(),
                outline_error_px: OUTLINE_ERROR_PX,
                annotations: Annotations::default(),
            }),
            _ => Err(Error::Usage(format!("--samples {samples}: allowed are 1, 4 (2 x 2) and 16 (4 x 4)"))),
        }
    }
}

/// Milliseconds of one frame's work, by stage, in order. `shadow`, `scene_pass` and `resolve` are measured by the
/// device where it can, and left out where it cannot; `gpu` is the whole wait from recording to the last pass's end.
pub type StageTimes = Vec<(&'static str, f64)>;

/// Layouts of the bind groups: 0 frame, 1 scene, 2 the pass's own.
#[derive(Debug)]
pub struct BindLayouts {
    frame: wgpu::BindGroupLayout,
    scene: wgpu::BindGroupLayout,
    shadow: wgpu::BindGroupLayout,
    resolve: wgpu::BindGroupLayout,
}

/// Renders scenes on one device.
#[derive(Debug)]
pub struct Renderer {
    gpu: Gpu,
    layouts: BindLayouts,
    shadow_pass: ShadowPass,
    scene_pass: ScenePass,
    resolve_pass: ResolvePass,
    scene: GpuScene,
    targets: Option<(Targets, PackedFrame)>,
    timer: Option<Timer>,
    /// Whether triangles that cannot be seen are left out one by one (see [`facing`]); labels and picture are the same
    /// either way. At first, whether the device is a CPU: a GPU is faster without.
    pub pick_triangles: bool,
}

impl Renderer {
    /// Compiles everything on a device.
    ///
    /// # Errors
    /// [`Error::DeviceLost`] or [`Error::Device`].
    pub fn new(gpu: Gpu) -> Result<Self> {
        let layouts = BindLayouts::new(&gpu);
        let renderer = Self {
            shadow_pass: ShadowPass::new(&gpu, &layouts),
            scene_pass: ScenePass::new(&gpu, &layouts),
            resolve_pass: ResolvePass::new(&gpu, &layouts),
            scene: GpuScene::default(),
            targets: None,
            timer: Timer::new(&gpu),
            pick_triangles: gpu.info.device_type == wgpu::DeviceType::Cpu,
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
        let asked = settings.annotations;
        let mut drawn = *settings;
        drawn.annotations = hazards::drawn_for(asked);
        if scene.sensor.is_some() {
            drawn.annotations = drawn.annotations.with(Annotation::Hdr);
        }
        let (mut frame, mut times) = self.render_plain(scene, &drawn)?;
        let rendered = Instant::now();
        if let Some(sensor) = &scene.sensor {
            sensor::expose(&mut frame, sensor, scene.camera.exposure_ev);
            if !asked.contains(Annotation::Hdr) {
                frame.radiance = Vec::new();
            }
            times.push(("sensor", milliseconds(rendered.elapsed())));
        }
        if hazards::any(asked) {
            let start = Instant::now();
            hazards::add(&mut frame, scene, asked);
            times.push(("hazards", milliseconds(start.elapsed())));
        }
        Ok((frame, times))
    }

    /// A frame as the resolve makes it.
    fn render_plain(&mut self, scene: &Scene, settings: &RenderSettings) -> Result<(Frame, StageTimes)> {
        let start = Instant::now();
        // What a lens brings onto the picture is drawn as a wider one without it, of which the resolve takes the samples.
        let picture = settings;
        let wide = (!scene.camera.lens.is_pinhole()).then(|| {
            let (camera, size) = scene.camera.widened(picture.size);
            (Scene { camera, ..scene.clone() }, RenderSettings { size, ..*picture })
        });
        let (scene, settings) = wide.as_ref().map_or((scene, picture), |(scene, settings)| (scene, settings));
        let (targets, packed) = match self.targets.take() {
            Some(kept) if kept.0.serve(settings) && kept.1.size == picture.size => kept,
            _ => {
                let targets = Targets::new(&self.gpu, settings)?;
                (targets, PackedFrame::new(&self.gpu, picture.size, settings.annotations))
            }
        };
        self.resolve_pass.prepare(&self.gpu, &targets, &packed);
        let (gpu, gpu_scene, pick_triangles) = (&self.gpu, &mut self.scene, self.pick_triangles);
        gpu.guard(|| gpu_scene.upload(gpu, scene, settings, picture.size, pick_triangles))?;
        self.scene_pass.prepare(&self.gpu, self.scene.variant(settings.annotations));
        self.shadow_pass.prepare(&self.gpu, self.scene.atlas_layer_px);
        self.gpu.check()?;
        let uploaded = Instant::now();
        self.gpu.guard(|| self.submit_frame(&targets, &packed))?;
        self.gpu.wait()?;
        let drawn = Instant::now();
        let mut frame = packed.read(&self.gpu)?;
        frame.focal_px = scene.camera.focal_px(settings.size[0]);
        frame.lens = scene.camera.lens;
        let read = Instant::now();
        let mut times = vec![("upload", milliseconds(uploaded - start))];
        if let Some(timer) = &self.timer {
            times.extend(timer.read(&self.gpu)?);
        }
        times.extend([("gpu", milliseconds(drawn - uploaded)), ("readback", milliseconds(read - drawn))]);
        self.targets = Some((targets, packed));
        if settings.annotations.contains(Annotation::Instances) {
            frame.rocks = labels::rocks(scene, settings, picture.size, &frame);
            times.push(("labels", milliseconds(read.elapsed())));
        }
        Ok((frame, times))
    }

    fn submit_frame(&self, targets: &Targets, packed: &PackedFrame) {
        let mut encoder =
            self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        self.record_frame(&mut encoder, targets, packed);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// The frame: shadow atlas, scene, resolve, copy.
    fn record_frame(&self, encoder: &mut wgpu::CommandEncoder, targets: &Targets, packed: &PackedFrame) {
        let groups = self.bind_groups(targets, packed);
        let timer = self.timer.as_ref();
        self.shadow_pass.record(
            encoder,
            &self.scene,
            [&groups.frame, &groups.scene],
            timer.map(|timer| timer.render_pass(0)),
        );
        self.scene_pass.record(
            encoder,
            &self.scene,
            [&groups.frame, &groups.scene, &groups.shadow],
            targets,
            timer.map(|timer| timer.render_pass(1)),
        );
        self.resolve_pass.record(
            encoder,
            &groups.frame,
            &groups.resolve,
            targets,
            packed,
            timer.map(|timer| timer.compute_pass(2)),
        );
        packed.copy(encoder);
        if let Some(timer) = timer {
            timer.copy(encoder);
        }
    }

    fn bind_groups(&self, targets: &Targets, packed: &PackedFrame) -> BindGroups {
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
            frame: group(
                "frame",
                &self.layouts.frame,
                &[scene.frame.buffer().as_entire_binding(), scene.relief.buffer().as_entire_binding()],
            ),
            scene: group(
                "scene",
                &self.layouts.scene,
                &[scene.instances.buffer().as_entire_binding(), scene.tiles.buffer().as_entire_binding()],
            ),
            shadow: group(
                "scene/shadow",
                &self.layouts.shadow,
                &[
                    view(self.shadow_pass.atlas()),
                    view(horizon),
                    scene.caster_grid.buffer().as_entire_binding(),
                ],
            ),
            resolve: group("resolve", &self.layouts.resolve, &{
                let planes = targets.planes.iter().chain([&targets.depth]).map(view);
                planes.chain([packed.buffer.as_entire_binding()]).collect::<Vec<_>>()
            }),
        }
    }
}

struct BindGroups {
    frame: wgpu::BindGroup,
    scene: wgpu::BindGroup,
    shadow: wgpu::BindGroup,
    resolve: wgpu::BindGroup,
}

impl BindLayouts {
    fn new(gpu: &Gpu) -> Self {
        let group = |label, stages: ShaderStages, bindings: &[BindingType]| {
            let entries: Vec<_> = (0..)
                .zip(bindings)
                .map(|(binding, &ty)| wgpu::BindGroupLayoutEntry {
                    binding,
                    visibility: stages,
                    ty,
                    count: None,
                })
                .collect();
            gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(label),
                entries: &entries,
            })
        };
        let buffer = |ty| BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
        let read = buffer(wgpu::BufferBindingType::Storage { read_only: true });
        let write = buffer(wgpu::BufferBindingType::Storage { read_only: false });
        let texture = |sample_type| BindingType::Texture {
            sample_type,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let float = texture(TextureSampleType::Float { filterable: false });
        let uint = texture(TextureSampleType::Uint);
        let drawing = ShaderStages::VERTEX_FRAGMENT;
        Self {
            frame: group(
                "frame",
                drawing | ShaderStages::COMPUTE,
                &[buffer(wgpu::BufferBindingType::Uniform); 2],
            ),
            scene: group("scene", drawing, &[read, read]),
            shadow: group("scene/shadow", ShaderStages::FRAGMENT, &[float, float, read]),
            resolve: group(
                "resolve",
                ShaderStages::COMPUTE,
                &[float, uint, float, uint, float, float, write],
            ),
        }
    }
}

fn vertex_layout(attributes: &[wgpu::VertexAttribute]) -> wgpu::VertexBufferLayout<'_> {
    wgpu::VertexBufferLayout {
        array_stride: size_of::<Vertex>() as u64,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes,
    }
}

fn draw_all(pass: &mut wgpu::RenderPass<'_>, scene: &GpuScene, indices: &gpu_scene::Store, draws: &[Draw]) {
    pass.set_vertex_buffer(0, scene.vertices.buffer().slice(..));
    pass.set_index_buffer(indices.buffer().slice(..), wgpu::IndexFormat::Uint32);
    for draw in draws {
        if !draw.instances.is_empty() && !draw.indices.is_empty() {
            pass.draw_indexed(draw.indices.clone(), draw.base_vertex, draw.instances.clone());
        }
    }
}

fn milliseconds(duration: std::time::Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
