//! The shadow map that the device makes, in render passes or in a compute pass, and what it depends on: it stays for as long as sun,
//! casters and tiles do.

use std::sync::{Arc, Weak};

use glam::Vec3;
use wgpu::TextureUsages;

use crate::gpu::Gpu;
use crate::pool::PooledVec;
use crate::render::device::bind_groups::SHADOW_MAP_FORMAT;
use crate::render::device::shader_structs::CasterTile;
use crate::render::select::selection::Selection;
use crate::scene::Scene;
use crate::scene::mesh::Vertex;

/// The map on the device.
#[derive(Debug, Default)]
pub(super) struct DeviceMap {
    view: Option<wgpu::TextureView>,
    /// What it is made from, by this frame or by one before.
    source: Option<MapSource>,
    /// A frame before has made it.
    is_kept: bool,
}

impl DeviceMap {
    /// Readies the map of a frame, unless the device has it, with exactly the columns and rows of its source. Not more: in render passes
    /// positions in it would be rounded otherwise, and a frame would depend on those before it. Returns whether it is another texture.
    pub(super) fn prepare(&mut self, gpu: &Gpu, source: MapSource) -> bool {
        let size_px = |source: &MapSource| source.size_px;
        let is_new = self.source.as_ref().map(size_px) != Some(source.size_px);
        self.is_kept = self.source.as_ref() == Some(&source);
        if is_new {
            let usage = TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING;
            self.view = Some(gpu.texture("shadow/map", source.size_px, SHADOW_MAP_FORMAT, usage).1);
        }
        self.source = Some(source);
        is_new
    }

    /// Whether it is that of a frame before, so that there is nothing to record.
    pub(super) const fn is_kept(&self) -> bool {
        self.is_kept
    }

    /// The map.
    ///
    /// # Panics
    /// Before [`Self::prepare`].
    pub(super) fn view(&self) -> &wgpu::TextureView {
        self.view.as_ref().expect("a map is prepared before it is used")
    }

    /// Its columns and rows.
    ///
    /// # Panics
    /// As [`Self::view`].
    pub(super) fn size_px(&self) -> [u32; 2] {
        self.source.as_ref().expect("a map is prepared before it is used").size_px
    }
}

/// What a map depends on.
#[derive(Clone, Debug)]
pub(crate) struct MapSource {
    sun_direction: Vec3,
    /// Columns and rows.
    size_px: [u32; 2],
    casters: Vec<CasterSource>,
}

/// What a tile depends on.
#[derive(Clone, Debug)]
struct CasterSource {
    /// Identifies the mesh: while this exists its address goes to no other mesh, though the mesh itself may be dropped.
    mesh: Weak<PooledVec<Vertex>>,
    level: usize,
    tile: CasterTile,
}

impl MapSource {
    /// That of a selection whose tiles are placed in a map of these columns and rows.
    pub(crate) fn new(scene: &Scene, selection: &Selection, size_px: [u32; 2]) -> Self {
        let casters = selection.rocks.iter().filter_map(|selected| {
            let (caster, level) = selected.caster?;
            let mesh = Arc::downgrade(&scene.rocks[selected.rock].vertices);
            Some(CasterSource { mesh, level, tile: selection.casters[caster].tile })
        });
        Self { sun_direction: scene.sun.direction, size_px, casters: casters.collect() }
    }
}

impl PartialEq for MapSource {
    fn eq(&self, other: &Self) -> bool {
        (self.sun_direction, self.size_px) == (other.sun_direction, other.size_px)
            && self.casters == other.casters
    }
}

impl PartialEq for CasterSource {
    fn eq(&self, other: &Self) -> bool {
        self.mesh.ptr_eq(&other.mesh)
            && self.level == other.level
            && bytemuck::bytes_of(&self.tile) == bytemuck::bytes_of(&other.tile)
    }
}
