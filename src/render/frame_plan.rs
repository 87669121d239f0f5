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
use shade::{ground_light, lit_rocks, set_surroundings};
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
const MAX_SLOTS: u32 = 1 << 16;

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
        if selection.slots().dome().end > MAX_SLOTS {
            return Err(Error::Contradiction(format!(
                "the view has more than {MAX_SLOTS} rocks and stars; choose fewer (rocks.coverage, rocks.count, sky.star_count)"
            )));
        }
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
        let mut lit_rocks = lit_rocks(scene, settings, &selection, &caster_grid, &horizon);
        let mut uniforms = frame_uniforms(scene, settings, image_size, &horizon, &bounced);
        uniforms.lit_rocks = lit_rocks.uniform(caster_grid.len());
        uniforms.ground_light = ground_light.uniform(lit_rocks.append(&ground_light.texels));
        let mut instances = instances(scene, settings, slots, bands.bands.len(), options.lighting);
        if let Some(ground) = &ground {
            set_surroundings(scene, &selection, ground, &horizon, &mut instances);
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
mod tests {
    use glam::{Vec2, Vec3};

    use super::*;
    use crate::params::Params;
    use crate::params::config::Config;
    use crate::render::device::bind_groups::slot_stride;
    use crate::render::select::lit_rocks::Exposed;
    use crate::render::select::screen_bounds::ScreenBounds;
    use crate::render::select::sunlight::Sunlight;
    use crate::render::settings::DEFAULT_TEXTURE_PX;
    use crate::scene::mesh::Icosphere;

    fn plan(cache: &PlanCache, scene: &Scene, options: &RasterOptions) -> FramePlan {
        let settings = RenderSettings::new([96, 64], 4).expect("settings");
        let mut plan = FramePlan::new(cache, scene, &settings, settings.size, options).expect("a plan");
        plan.place_tiles(|selection| Some(casters::atlas_size_px(&selection.casters)));
        plan
    }

    const fn options(backend: RasterBackend) -> RasterOptions {
        RasterOptions {
            visibility: backend,
            shadow: backend,
            bin_by_shadow_sources: true,
            multi_draw: false,
            lighting: LightingMode::Bins,
            max_texture_px: DEFAULT_TEXTURE_PX,
        }
    }

    fn scene(seed: u64) -> Scene {
        Scene::build(seed, &Params::draw_default(seed)).expect("a scene")
    }

    #[test]
    fn a_plan_lists_every_draw_of_the_device_once_and_none_of_the_host() {
        let scene = scene(1);
        let plan_for_device = plan(&PlanCache::default(), &scene, &options(RasterBackend::Device));
        let selection = &plan_for_device.selection;
        let DrawList { draws, casters, batches } = &plan_for_device.draws;
        assert_eq!(casters.clone(), 0..selection.casters.len());
        let batched: Vec<usize> = batches.iter().flat_map(|batch| batch.draws.clone()).collect();
        assert_eq!(batched, (casters.end..draws.len()).collect::<Vec<_>>(), "bins in order");
        let visible_rocks = selection.rocks.iter().filter(|rock| rock.visible_level.is_some()).count();
        let slots = selection.slots();
        let spheres = [slots.stars(), slots.sun(), slots.dome()];
        let spheres = spheres.iter().filter(|slots| !slots.is_empty()).count();
        assert_eq!(batched.len(), visible_rocks + selection.blocks.len() + spheres);
        assert!(visible_rocks > 0 && !casters.is_empty() && !selection.blocks.is_empty());
        for batch in batches {
            assert_eq!(batch.draws.is_empty(), batch.bounds == ScreenBounds::EMPTY, "bin {}", batch.bin);
        }

        let plan_for_host = plan(&PlanCache::default(), &scene, &options(RasterBackend::Host));
        let list = &plan_for_host.draws;
        assert!(list.draws.is_empty() && list.casters.is_empty());
        assert!(list.batches.iter().all(|batch| batch.bounds == ScreenBounds::EMPTY));
        assert_eq!(list.batches.len(), batches.len());
    }

    #[test]
    fn every_slot_of_a_draw_is_an_instance() {
        let plan = plan(&PlanCache::default(), &scene(2), &options(RasterBackend::Device));
        let dome = plan.selection.slots().dome();
        assert_eq!(dome.end as usize, plan.instances.len());
        for draw in &plan.draws.draws {
            assert!(!draw.slots.is_empty() && draw.slots.end <= dome.end, "{draw:?}");
        }
        for batch in &plan.draws.batches {
            assert!((batch.instance as usize) < plan.instances.len());
            assert!((batch.relief as usize) < plan.bands.bands.len());
        }
        assert_eq!(slot_stride::<Instance>() % 256, 0);
    }

    #[test]
    fn a_plan_does_not_depend_on_that_of_another_scene() {
        let options = options(RasterBackend::Device);
        let (first, second) = (scene(3), scene(4));
        let alone = plan(&PlanCache::default(), &second, &options);
        let cache = PlanCache::default();
        let of_other = plan(&cache, &first, &options);
        let after_another = plan(&cache, &second, &options);
        assert!(!Arc::ptr_eq(&of_other.horizon, &after_another.horizon));
        assert_eq!(bytemuck::bytes_of(&after_another.uniforms), bytemuck::bytes_of(&alone.uniforms));
        assert!(after_another.caster_grid[..] == alone.caster_grid[..], "caster grid");
        assert!(after_another.horizon.heights_m == alone.horizon.heights_m, "horizon");
        assert_same_draws(&after_another, &alone);
    }

    #[test]
    fn plans_under_an_unmoved_sun_share_the_horizon_of_all_of_the_ground() {
        let (options, scene) = (options(RasterBackend::Device), scene(4));
        let mut moved = scene.clone();
        moved.camera.eye.x += 0.5;
        let cache = PlanCache::default();
        let first = plan(&cache, &scene, &options);
        assert!(Arc::ptr_eq(&first.horizon, &plan(&cache, &scene, &options).horizon), "nothing moved");
        let second = plan(&cache, &moved, &options);
        assert!(
            !Arc::ptr_eq(&first.horizon, &second.horizon),
            "of all of the ground, once the sun has not moved"
        );
        let third = plan(&cache, &scene, &options);
        assert!(Arc::ptr_eq(&second.horizon, &third.horizon));
        assert_same_draws(&third, &first);
    }

    fn assert_same_draws(left: &FramePlan, right: &FramePlan) {
        let bytes = |plan: &FramePlan| bytemuck::cast_slice::<_, u8>(&plan.instances).to_vec();
        assert!(bytes(left) == bytes(right), "instances");
        assert_eq!(left.draws.draws, right.draws.draws);
        assert_eq!(left.shadow_map_px, right.shadow_map_px);
    }

    /// Whether a ray towards the sun meets a triangle of a rock (Moeller and Trumbore 1997).
    fn is_shaded_by(scene: &Scene, rock: usize, point: Vec3) -> bool {
        let (rock, sun) = (&scene.rocks[rock], scene.sun.direction);
        let offset = rock.centre - point;
        if (offset - offset.dot(sun) * sun).length() > rock.radius_m {
            return false;
        }
        Icosphere::shared().triangles[rock.level].iter().any(|corners| {
            let [a, b, c] = corners.map(|corner| rock.centre + rock.vertices[corner as usize].position);
            let (ab, ac, from_a) = (b - a, c - a, point - a);
            let (across, turned) = (sun.cross(ac), from_a.cross(ab));
            let determinant = ab.dot(across);
            let at = [from_a.dot(across), sun.dot(turned), ac.dot(turned)].map(|of| of / determinant);
            at[0] >= 0.0 && at[1] >= 0.0 && at[0] + at[1] <= 1.0 && at[2] > 0.0
        })
    }

    #[test]
    fn rocks_shade_what_rays_find_in_their_shadow() {
        let scene = scene(5);
        let plan = plan(&PlanCache::default(), &scene, &options(RasterBackend::Host));
        let casters = &plan.selection.casters;
        let sunlight = Sunlight::new(&scene, casters, &plan.caster_grid, &|_| [f32::MIN; 2]);
        let [right, _] = scene.sun.right_and_up();
        let away = -scene.sun.direction.truncate().normalize();
        let (mut shaded, mut sunlit, mut wrong) = (0, 0, 0);
        for caster in casters.iter().take(60) {
            let (centre, radius_m) = (caster.tile.centre, caster.tile.half_extent_m);
            for (along, across) in [1.5, 2.5, 3.5].into_iter().flat_map(|along| {
                [-1.5, -0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9, 1.5].map(|across| (along, across))
            }) {
                let at = centre.truncate() + radius_m * (along * away + across * right.truncate());
                let point = at.extend(scene.terrain.surface_height_at(at) + 0.2 * radius_m);
                let expected = casters.iter().any(|caster| is_shaded_by(&scene, caster.rock, point));
                let found = sunlight.past_rocks(point, 0.02 * radius_m, usize::MAX) < 0.5;
                *(if expected { &mut shaded } else { &mut sunlit }) += 1;
                wrong += u32::from(found != expected);
            }
        }
        assert!(shaded > 200 && sunlit > 400, "{shaded} points in shadow, {sunlit} in sunlight");
        assert!(wrong < (shaded + sunlit) / 20, "{wrong} of {shaded} and {sunlit} points are wrong");
    }

    /// Rocks of less than five pixels too: lit as in the open they would glow.
    #[test]
    fn the_smallest_rocks_are_dark_in_the_shadow_of_the_ground() {
        let mut config = Config::new();
        for setting in ["stage.name=surface", "sun.elevation_deg=8"] {
            config.apply_set(setting).expect(setting);
        }
        let (mut in_shadow, mut small, mut sum) = (0_u32, 0, 0.0);
        for seed in [51_280, 51_281, 51_282] {
            let scene = Scene::build(seed, &config.draw(seed).expect("knobs")).expect("a scene");
            let plan = plan(&PlanCache::default(), &scene, &options(RasterBackend::Host));
            let limbs = |point| plan.horizon.limbs_at(point);
            let sunlight = Sunlight::new(&scene, &plan.selection.casters, &plan.caster_grid, &limbs);
            for (index, selected) in plan.selection.rocks.iter().enumerate() {
                let rock = &scene.rocks[selected.rock];
                let foot = Exposed::new(&scene, rock).foot;
                // All around, further than the ground that a rock is lit by.
                let is_in_shadow = (0..8).all(|k| {
                    let (sin, cos) = libm::sincosf(0.785 * k as f32);
                    let at = foot.truncate() + 6.5 * rock.base_scale_m * Vec2::new(cos, sin);
                    sunlight.past_ground(at.extend(scene.terrain.surface_height_at(at))) == 0.0
                });
                if selected.visible_level.is_none() || !is_in_shadow {
                    continue;
                }
                let sides = plan.instances[Slots::rock(index) as usize].lit_below;
                let relative = sides.iter().sum::<f32>() / 4.0;
                sum += relative;
                assert!(relative < 0.6, "seed {seed}, rock {}: {sides:?}", selected.rock);
                in_shadow += 1;
                // The image has 96 pixels over some 70 degrees.
                small += u32::from(2.0 * rock.base_scale_m < 0.012 * selected.nearest_m);
            }
        }
        assert!(in_shadow > 20 && small > 10, "{in_shadow} rocks in shadow, {small} of them small");
        let mean = sum / in_shadow as f32;
        assert!((0.02..0.3).contains(&mean), "{mean} of the light in the open");
    }
}
