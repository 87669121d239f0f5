//! Layouts of the bind groups that the passes share: group 0 is the frame's, group 1 the scene's, group 2 the pass's own. Group 3 is
//! in no other pass than that of `lighting/compute.rs`.
//! Must not know: a pass.

use wgpu::{BindingType, ShaderStages, TextureFormat, TextureSampleType};

use crate::gpu::Gpu;
use crate::render::device::planes::SAMPLE_PLANES;
use crate::render::device::shader_structs::{Instance, ReliefUniforms};

/// Format of the shadow map, which a compute pass writes as a storage texture.
pub(crate) const SHADOW_MAP_FORMAT: TextureFormat = TextureFormat::R32Float;

/// One layout for each kind of bind group.
#[derive(Debug)]
pub struct BindLayouts {
    /// Group 0 of every pass: `FrameUniforms`.
    pub frame: wgpu::BindGroupLayout,
    /// Group 1 of the drawing passes: the instance of the draw, caster tiles, its relief, all instances, all reliefs.
    pub scene: wgpu::BindGroupLayout,
    /// Group 1 of compute passes that rasterise: of the scene's group all instances alone.
    pub instances: wgpu::BindGroupLayout,
    /// Group 2 of the shadow map's compute pass: depth layers, map.
    pub layers: wgpu::BindGroupLayout,
    /// Group 2 of the lighting pass: visibility, shadow map, horizon, caster grid, sampler, slopes, sunlit faces of rocks.
    pub light: wgpu::BindGroupLayout,
    /// Group 2 of the resolve pass: visibility, packed frame, sampler, tile list, then the planes of samples.
    pub resolve: wgpu::BindGroupLayout,
}

impl BindLayouts {
    /// Creates the layouts on a device.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let group = |label, stages, bindings: &[BindingType]| {
            bind_group_layout(gpu, label, stages, (0..).zip(bindings.iter().copied()))
        };
        let slot = |bytes: usize| BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: true,
            min_binding_size: wgpu::BufferSize::new(bytes as u64),
        };
        let (instance, relief) = (slot(size_of::<Instance>()), slot(size_of::<ReliefUniforms>()));
        let uniforms = BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let (read, write) = (storage_buffer(true), storage_buffer(false));
        let texture = |sample_type| BindingType::Texture {
            sample_type,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let float = texture(TextureSampleType::Float { filterable: false });
        let uint = texture(TextureSampleType::Uint);
        let map = storage_texture(SHADOW_MAP_FORMAT);
        let nearest = BindingType::Sampler(wgpu::SamplerBindingType::NonFiltering);
        let resolve = [uint, write, nearest, read];
        let sample_planes = SAMPLE_PLANES.map(|row| if row.is_uint() { uint } else { float });
        let drawing = ShaderStages::VERTEX_FRAGMENT;
        Self {
            frame: group("frame", drawing | ShaderStages::COMPUTE, &[uniforms]),
            instances: bind_group_layout(gpu, "instances", ShaderStages::COMPUTE, [(ALL_INSTANCES, read)]),
            scene: group("scene", drawing | ShaderStages::COMPUTE, &[instance, read, relief, read, read]),
            layers: group("layers", ShaderStages::COMPUTE, &[float, map]),
            light: group(
                "light",
                ShaderStages::FRAGMENT | ShaderStages::COMPUTE,
                &[uint, float, float, read, nearest, float, float],
            ),
            resolve: group("resolve", ShaderStages::COMPUTE, &[&resolve[..], &sample_planes].concat()),
        }
    }
}

/// Binding of all instances in the scene's group.
const ALL_INSTANCES: u32 = 3;

/// A layout of these bindings.
#[must_use]
pub(crate) fn bind_group_layout(
    gpu: &Gpu,
    label: &str,
    visibility: ShaderStages,
    bindings: impl IntoIterator<Item = (u32, BindingType)>,
) -> wgpu::BindGroupLayout {
    let entry = |(binding, ty)| wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None };
    let entries: Vec<_> = bindings.into_iter().map(entry).collect();
    let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries };
    gpu.device.create_bind_group_layout(&descriptor)
}

/// A storage buffer.
pub(crate) const fn storage_buffer(read_only: bool) -> BindingType {
    BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

/// A texture that is written.
pub(crate) const fn storage_texture(format: TextureFormat) -> BindingType {
    BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format,
        view_dimension: wgpu::TextureViewDimension::D2,
    }
}

/// The bind groups of a frame that passes which rasterise share.
#[derive(Debug)]
pub(crate) struct RasterGroups {
    /// Group 0.
    pub(crate) frame: wgpu::BindGroup,
    /// Group 1 of render passes. Its dynamic offsets are those of the slots of an instance and of a relief ([`slot_stride`]).
    pub(crate) scene: wgpu::BindGroup,
    /// Group 1 of compute passes.
    pub(crate) instances: wgpu::BindGroup,
}

/// The bind group of [`BindLayouts::instances`].
#[must_use]
pub(crate) fn instances_group(gpu: &Gpu, layouts: &BindLayouts, instances: &wgpu::Buffer) -> wgpu::BindGroup {
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("instances"),
        layout: &layouts.instances,
        entries: &[wgpu::BindGroupEntry { binding: ALL_INSTANCES, resource: instances.as_entire_binding() }],
    })
}

/// Bytes from one slot of a buffer of uniforms to the next: by WebGPU's default limits, dynamic offsets are multiples of 256.
#[must_use]
pub(crate) const fn slot_stride<T>() -> u32 {
    size_of::<T>().next_multiple_of(256) as u32
}

/// A bind group of these resources, in the order of their bindings.
#[must_use]
pub(crate) fn bind_group(
    gpu: &Gpu,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: &[wgpu::BindingResource<'_>],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(resources)
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}
