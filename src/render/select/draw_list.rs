//! What a frame draws: meshes by reference, and batches by shading bin.
//! Must not know: a device, where a mesh lies in its buffers.

use std::ops::Range;

use crate::render::backend::{LightingMode, RasterBackend, RasterOptions};
use crate::render::device::shading_bins::{LightingVariant, ShadingBin, ShadingBins, ShadowSources};
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::select::selection::{Slots, front_to_back};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::sky::{DOME_LEVEL, STAR_LEVEL, SUN_LEVEL};

/// A mesh of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MeshRef {
    /// A rock, by its index in the scene, at a level of detail.
    Rock {
        /// Index in the scene.
        rock: usize,
        /// Level of the icosphere.
        level: usize,
    },
    /// A block of the ground, by its index in [`crate::render::select::ground_blocks`].
    Block(usize),
    /// The unit sphere at a level of the icosphere.
    UnitSphere(usize),
}

/// One instanced draw of a mesh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct MeshDraw {
    /// The mesh.
    pub mesh: MeshRef,
    /// Slots of its instances.
    pub slots: Range<u32>,
}

/// The samples of one shading bin: rasterised with one stencil reference, and lit by one draw of the lighting pass.
#[derive(Clone, Debug)]
pub struct DrawBatch {
    /// The bin.
    pub bin: ShadingBin,
    /// The pipeline that lights it.
    pub variant: LightingVariant,
    /// Slot of its instance; of rocks, whose samples hold the slot themselves, any.
    pub instance: u32,
    /// Slot of its relief uniforms.
    pub relief: u32,
    /// Its draws in [`DrawList::draws`], where the device rasterises visibility.
    pub draws: Range<usize>,
    /// Bounds of its samples on the image, [`ScreenBounds::EMPTY`] if it has none.
    pub bounds: ScreenBounds,
}

/// The draws of a frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct DrawList {
    /// What the device rasterises: casters first, then each batch's draws, near ones first.
    pub draws: Vec<MeshDraw>,
    /// The shadow casters in [`Self::draws`].
    pub casters: Range<usize>,
    /// One batch for each shading bin of the frame, by bin; those that nothing is drawn of have no bounds.
    pub batches: Vec<DrawBatch>,
}

impl DrawList {
    /// Lists the draws of a selection. `band_of_block` gives the relief band of a block of the ground.
    #[must_use]
    pub(crate) fn new(
        scene: &Scene,
        settings: &RenderSettings,
        slots: Slots<'_>,
        bins: ShadingBins,
        band_of_block: impl Fn(usize) -> usize,
        options: &RasterOptions,
    ) -> Self {
        let mut list = Self { draws: Vec::new(), casters: 0..0, batches: empty_batches(bins, slots) };
        if options.shadow != RasterBackend::Host {
            list.add_casters(slots);
        }
        if options.visibility != RasterBackend::Host {
            list.add_visible(scene, settings, slots, bins, band_of_block, options.lighting);
        }
        list
    }

    fn add_casters(&mut self, slots: Slots<'_>) {
        let casters = (0..).zip(&slots.selection().rocks).filter_map(|(index, selected)| {
            let (_, level) = selected.caster?;
            Some(rock_draw(selected.rock, level, Slots::rock(index)))
        });
        self.draws.extend(casters);
        self.casters = 0..self.draws.len();
    }

    /// Adds everything in view to the batches of its bins, near surfaces before those that they may occlude.
    fn add_visible(
        &mut self,
        scene: &Scene,
        settings: &RenderSettings,
        slots: Slots<'_>,
        bins: ShadingBins,
        band_of_block: impl Fn(usize) -> usize,
        lighting: LightingMode,
    ) {
        let selection = slots.selection();
        let mut binned: Vec<(ShadingBin, MeshDraw)> = Vec::new();
        let mut add = |bin: ShadingBin, draw: MeshDraw, bounds: ScreenBounds| {
            let batch = &mut self.batches[usize::from(bin)];
            batch.bounds = batch.bounds.union(bounds);
            binned.push((bin, draw));
        };
        let rocks = (0..).zip(&selection.rocks).filter_map(|(index, selected)| {
            let rock = &scene.rocks[selected.rock];
            let draw = rock_draw(selected.rock, selected.visible_level?, Slots::rock(index));
            let bounds = ScreenBounds::of_sphere(scene, settings, rock.centre, rock.radius_m);
            Some((selected.nearest_m, (draw, bounds)))
        });
        for (_, (draw, bounds)) in front_to_back(rocks) {
            add(ShadingBins::rocks(ShadowSources::GroundAndRocks), draw, bounds);
        }
        let blocks = selection.blocks.iter().map(|&(block, nearest_m)| (nearest_m, block));
        for (_, block) in front_to_back(blocks) {
            let band = band_of_block(block);
            let bin = ShadingBins::ground(band, ShadowSources::GroundAndRocks);
            let slot = if lighting.is_by_instance() { slots.ground_of_band(band) } else { Slots::GROUND };
            let draw = MeshDraw { mesh: MeshRef::Block(block), slots: slot..slot + 1 };
            add(bin, draw, ScreenBounds::UNBOUNDED);
        }
        let sky = [
            (bins.stars(), STAR_LEVEL, slots.stars()),
            (bins.sun(), SUN_LEVEL, slots.sun()),
            (bins.dome(), DOME_LEVEL, slots.dome()),
        ];
        for (bin, level, slots) in sky.into_iter().filter(|(.., slots)| !slots.is_empty()) {
            add(bin, MeshDraw { mesh: MeshRef::UnitSphere(level), slots }, ScreenBounds::UNBOUNDED);
        }
        // Stable: the draws of a bin stay in their order.
        binned.sort_by_key(|(bin, _)| *bin);
        for of_bin in binned.chunk_by(|a, b| a.0 == b.0) {
            let first = self.draws.len();
            self.draws.extend(of_bin.iter().map(|(_, draw)| draw.clone()));
            self.batches[usize::from(of_bin[0].0)].draws = first..self.draws.len();
        }
    }
}

const fn rock_draw(rock: usize, level: usize, slot: u32) -> MeshDraw {
    MeshDraw { mesh: MeshRef::Rock { rock, level }, slots: slot..slot + 1 }
}

/// A batch without draws for each bin, by bin.
fn empty_batches(bins: ShadingBins, slots: Slots<'_>) -> Vec<DrawBatch> {
    let instance = |bin| match bin {
        _ if bin == bins.stars() => slots.stars().start,
        _ if bin == bins.sun() => slots.sun().start,
        _ if bin == bins.dome() => slots.dome().start,
        _ => Slots::GROUND,
    };
    let batches = (0..).zip(bins.all()).map(|(bin, (variant, band))| DrawBatch {
        bin,
        variant,
        instance: instance(bin),
        relief: band as u32,
        draws: 0..0,
        bounds: ScreenBounds::EMPTY,
    });
    batches.collect()
}
