//! What a shadow map that the device makes depends on, and whether it has it from an earlier frame: a map stays for as long as sun,
//! casters and tiles do.

use std::sync::{Arc, Weak};

use glam::Vec3;

use crate::pool::PooledVec;
use crate::render::device::shader_structs::CasterTile;
use crate::render::select::selection::Selection;
use crate::scene::Scene;
use crate::scene::mesh::Vertex;

/// What the map of the device is made from.
#[derive(Debug, Default)]
pub(super) struct KeptMap {
    /// By this frame or by one before.
    source: Option<MapSource>,
    /// A frame before has made the map of this one.
    pub(super) is_kept: bool,
}

impl KeptMap {
    /// Whether the map that the device has is that of a frame with this source; otherwise the frame makes it.
    pub(super) fn holds(&mut self, source: MapSource) -> bool {
        self.is_kept = self.source.as_ref() == Some(&source);
        self.source = Some(source);
        self.is_kept
    }

    /// The next frame makes the map, whatever the device has.
    pub(super) fn invalidate(&mut self) {
        self.source = None;
    }
}

/// What a map depends on.
#[derive(Clone, Debug)]
pub(super) struct MapSource {
    sun_direction: Vec3,
    /// Columns and rows.
    pub(super) size_px: [u32; 2],
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
    pub(super) fn new(scene: &Scene, selection: &Selection, size_px: [u32; 2]) -> Self {
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
