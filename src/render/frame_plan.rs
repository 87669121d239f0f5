//! The plan of a frame: every decision that is made before anything is uploaded. Plain data.
//!
//! A frame depends on scene, settings and options alone, and is planned on any thread. Frames share what does not change under an
//! unmoved sun: bounced light, and from the second frame on the horizon map of all of the ground ([`PlanCache`]).
//! Must not know: a device.

mod shade;
pub(super) mod uniforms;

use std::sync::{Arc, Mutex, PoisonError};

use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::pool::PooledVec;
use crate::render::backend::{LightingMode, RasterBackend, RasterOptions};
use crate::render::device::shader_structs::{CasterTile, FrameUniforms, Instance};
use crate::render::device::shading_bins::{Detail, ShadingBins};
use crate::render::lighting::relief_bands::ReliefBands;
use crate::render::select::caster_grid::CasterCells;
use crate::render::select::casters;
use crate::render::select::draw_list::DrawList;
use crate::render::select::footprint::Footprint;
use crate::render::select::lit_rocks::LitRocks;
use crate::render::select::selection::{Selection, Slots};
use crate::render::settings::RenderSettings;
use crate::render::shadow::MapSource;
use crate::render::shadow::horizon::{HorizonCache, HorizonMap};
use crate::scene::Scene;
use crate::scene::bounce::Bounce;
use crate::scene::photometry::Photometry;
use shade::{LimbLookup, ground_light, lit_rocks, set_surroundings};
use uniforms::frame_uniforms;

/// All that is needed to draw a frame.
#[derive(Debug)]
pub(crate) struct FramePlan {
    /// What is in view and what casts shadows into it, with levels of detail.
    pub(crate) selection: Selection,
    /// Columns and rows of the shadow map, once its tiles are placed ([`FramePlan::place_tiles`]).
    pub(crate) shadow_map_px: [u32; 2],
    /// What the shadow map depends on, if the device makes it: then its tiles are placed already.
    pub(crate) map_source: Option<MapSource>,
    /// Horizon of the ground towards the sun.
    pub(crate) horizon: Arc<HorizonMap>,
    /// Which casters can shade each cell of the ground ([`CasterCells::grid`]).
    pub(crate) caster_grid: PooledVec<u32>,
    /// Sunlit rocks, and the cells that they light.
    pub(crate) lit_rocks: LitRocks,
    /// Tile of each caster in the shadow map.
    pub(crate) caster_tiles: Vec<CasterTile>,
    /// Relief below the mesh, by distance.
    pub(crate) bands: ReliefBands,
    /// Instances, by slot.
    pub(crate) instances: Vec<Instance>,
    /// What the device draws, and the batches of the shading bins.
    pub(crate) draws: DrawList,
    /// Uniforms of the frame.
    pub(crate) uniforms: FrameUniforms,
}

/// What frames share while ground and sun do not change. One for any number of threads.
#[derive(Debug, Default)]
pub(crate) struct PlanCache {
    horizon: HorizonCache,
    bounce: Mutex<BounceCache>,
}

/// Light that sunlit ground bounces, and what it was computed from: laws, sine of the sun's elevation.
#[derive(Debug, Default)]
struct BounceCache {
    key: Option<(Photometry, f32)>,
    bounce: Bounce,
}

impl BounceCache {
    fn get(cache: &Mutex<Self>, scene: &Scene) -> Bounce {
        let lock = || cache.lock().unwrap_or_else(PoisonError::into_inner);
        let key = Some((scene.photometry, scene.sun.direction.z));
        let cached = lock();
        if cached.key == key {
            return cached.bounce;
        }
        drop(cached);
        let bounce = Bounce::new(&scene.photometry, scene.sun.direction.z.into());
        *lock() = Self { key, bounce };
        bounce
    }
}

/// Most instances of a frame: the G-buffer has 16 bits for the slot of each.
const MAX_SLOTS: usize = 1 << 16;

impl FramePlan {
    /// Plans a frame. `image_size` is that of the image, which is smaller than the settings' where a lens distorts it.
    ///
    /// # Errors
    /// [`Error::Contradiction`] for more rocks and stars in view, or more shadows, than a device holds.
    pub(crate) fn new(
        cache: &PlanCache,
        scene: &Scene,
        settings: &RenderSettings,
        image_size: [u32; 2],
        options: &RasterOptions,
    ) -> Result<Self> {
        let selection = Selection::within(scene, settings, options.max_texture_px);
        check_slots(selection.slots().dome().end as usize)?;
        let footprint = Footprint::new(scene, &selection);
        let bounced = BounceCache::get(&cache.bounce, scene);
        // While the horizon is swept, grid after grid, other threads have little to do.
        let of_selection = || {
            let cells = || CasterCells::new(scene, &selection.casters, &footprint);
            let bands = || ReliefBands::new(scene, &selection, settings);
            rayon::join(cells, || {
                rayon::join(bands, || ground_light(scene, settings, &selection, &footprint, &bounced))
            })
        };
        let ((cells, (bands, (ground, ground_light))), horizon) = beside(of_selection, || {
            cache.horizon.map(&scene.terrain, &scene.sun, &footprint, options.max_texture_px)
        });
        let caster_grid = cells?.grid(horizon.shadowed_ground());
        let bins = ShadingBins::new(bands.bands.len());
        let slots = selection.slots();
        let band_of_block = |block| bands.of_block(block);
        let draws = DrawList::new(scene, settings, slots, bins, band_of_block, options);
        let limbs = ground.as_ref().map(|ground| LimbLookup::new(&horizon, &footprint, ground));
        let mut lit_rocks = limbs.as_ref().map_or_else(LitRocks::default, |limbs| {
            lit_rocks(scene, settings, &selection, &caster_grid, limbs)
        });
        let mut uniforms = frame_uniforms(scene, settings, image_size, &horizon, &bounced);
        uniforms.lit_rocks = lit_rocks.uniform(caster_grid.len());
        uniforms.ground_light = ground_light.uniform(lit_rocks.append(&ground_light.texels));
        let mut instances = instances(scene, settings, slots, bands.bands.len(), options.lighting);
        check_slots(instances.len())?;
        if let Some(limbs) = &limbs {
            set_surroundings(scene, &selection, limbs, &mut instances);
        }
        let mut plan = Self {
            shadow_map_px: [0; 2],
            map_source: None,
            caster_grid,
            lit_rocks,
            caster_tiles: Vec::new(),
            instances,
            draws,
            uniforms,
            bands,
            selection,
            horizon,
        };
        if options.shadow != RasterBackend::Host {
            plan.place_tiles(|selection| Some(casters::atlas_size_px(&selection.casters)));
            plan.map_source = Some(MapSource::new(scene, &plan.selection, plan.shadow_map_px));
        }
        Ok(plan)
    }

    /// Gives the casters' tiles their origins in the shadow map. `place` sets those of the selection and returns the size of the map, or
    /// `None` if they are placed. Where the host makes the map its backend does so, which may keep tiles of frames before.
    pub(crate) fn place_tiles(&mut self, place: impl FnOnce(&mut Selection) -> Option<[u32; 2]>) {
        let Some(size_px) = place(&mut self.selection) else { return };
        self.shadow_map_px = size_px;
        let [width_px, height_px] = self.shadow_map_px.map(|side| side as f32);
        (self.uniforms.atlas_width_px, self.uniforms.atlas_layer_height_px) = (width_px, height_px);
        let Selection { casters, rocks, .. } = &self.selection;
        self.caster_tiles.clear();
        self.caster_tiles.extend(casters.iter().map(|caster| caster.tile));
        for (instance, selected) in self.instances[Slots::rock(0) as usize..].iter_mut().zip(rocks) {
            if let Some((caster, _)) = selected.caster {
                instance.tile_origin_px = casters[caster].tile.origin_px;
            }
        }
    }
}

/// # Errors
/// [`Error::Contradiction`] for more than [`MAX_SLOTS`].
fn check_slots(count: usize) -> Result<()> {
    if count <= MAX_SLOTS {
        return Ok(());
    }
    Err(Error::Contradiction(format!(
        "the view has more than {MAX_SLOTS} rocks and stars; choose fewer (rocks.coverage, rocks.count, sky.star_count)"
    )))
}

/// Runs one closure on the threads of the pool while another, which may take locks, runs on this one. `rayon::join` may run both on the pool,
/// where a thread that holds a lock and waits for others may steal work that waits for the same lock.
fn beside<A: Send, B>(on_pool: impl FnOnce() -> A + Send, here: impl FnOnce() -> B) -> (A, B) {
    let mut of_pool = None;
    let of_here = rayon::in_place_scope(|scope| {
        scope.spawn(|_| of_pool = Some(on_pool()));
        here()
    });
    (of_pool.expect("the scope ends with its tasks"), of_here)
}

/// The instances of a frame, by slot: ground, rocks, stars, sun, dome; then the ground of each relief band where samples look up their
/// relief by their instance.
fn instances(
    scene: &Scene,
    settings: &RenderSettings,
    slots: Slots<'_>,
    bands: usize,
    lighting: LightingMode,
) -> Vec<Instance> {
    let detail = |detail: Detail| if scene.relief.is_some() { detail } else { Detail::None };
    let selection = slots.selection();
    let photometry = &scene.photometry;
    let (soil_surge, rock_surge) = (photometry.soil.b_s0 as f32, photometry.rock_b_s0 as f32);
    let at_normal = |surge: f32| photometry.at_normal(f64::from(surge)) as f32;
    let focal_px = scene.camera.focal_px(settings.size[0]) as f32;
    let soil = scene.regolith.albedo / at_normal(soil_surge);
    let mut instances = vec![Instance {
        scale: 1.0,
        colour: soil,
        surge_height: soil_surge,
        roughness: scene.regolith.roughness,
        class_id: ClassId::REGOLITH.0.into(),
        detail: detail(Detail::Relief).with_relief(0),
        ..Default::default()
    }];
    let rock_at_normal = at_normal(rock_surge);
    instances.extend(selection.rocks.iter().map(|selected| {
        let rock = &scene.rocks[selected.rock];
        let counts = scene.label_rule.draws_as_rock(rock, scene.camera.eye, focal_px);
        let tile = selected.caster.map_or_else(Default::default, |(tile, _)| selection.casters[tile].tile);
        let instance = Instance {
            origin: rock.centre,
            scale: 1.0,
            colour: rock.material.albedo / rock_at_normal,
            roughness: rock.material.roughness,
            class_id: if counts { ClassId::ROCK } else { ClassId::REGOLITH }.0.into(),
            instance_id: if counts { rock.index + 1 } else { 0 },
            surge_height: rock_surge,
            tile_half_extent_m: tile.half_extent_m,
            dust: soil,
            dust_surge_height: soil_surge,
            diameter_m: 2.0 * rock.base_scale_m,
            dust_min_normal_z: rock.dust_above,
            tile_size_px: tile.size_px,
            detail: detail(Detail::RockTexture).with_relief(0),
            ..Default::default()
        };
        if rock.body.is_rock() { instance } else { hardware(instance) }
    }));
    let in_sky = |origin, scale, colour| Instance {
        origin,
        scale,
        colour,
        class_id: ClassId::SKY.0.into(),
        detail: Detail::Emissive.with_relief(0),
        ..Default::default()
    };
    instances.extend(selection.stars.iter().map(|&star| {
        let star = scene.sky.stars[star];
        in_sky(star.centre, star.radius_m, scene.sky.star_radiance)
    }));
    instances.extend(selection.sun.map(|disc| Instance {
        disc_sine: scene.sun.disc_sine(),
        ..in_sky(disc.centre, disc.radius_m, scene.sun.disc_radiance())
    }));
    instances.push(in_sky(scene.sky.centre, scene.sky.radius_m, scene.sky.radiance));
    if lighting.is_by_instance() {
        let ground = instances[Slots::GROUND as usize];
        let of_band = |band| Instance { detail: detail(Detail::Relief).with_relief(band), ..ground };
        instances.extend((0..bands as u32).map(of_band));
    }
    instances
}

/// The instance of a part of the rover: smooth paint, without a rock's texture and dust.
fn hardware(rock: Instance) -> Instance {
    Instance {
        class_id: ClassId::HARDWARE.0.into(),
        instance_id: 0,
        diameter_m: 0.0,
        // Above every normal.
        dust_min_normal_z: 2.0,
        ..rock
    }
}

#[cfg(test)]
mod tests;
