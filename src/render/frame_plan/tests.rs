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

/// Of a map that was swept for another view the light in the shade reads no more than of its own.
#[test]
fn the_light_of_a_plan_does_not_depend_on_that_of_another_view() {
    let mut config = Config::new();
    for setting in
        ["photometry.law=hapke", "sun.elevation_deg=3", "terrain.amplitude_m=12", "rocks.count=600"]
    {
        config.apply_set(setting).expect(setting);
    }
    let options = options(RasterBackend::Host);
    let scene = Scene::build(3, &config.draw(3).expect("knobs")).expect("a scene");
    let mut turned = scene.clone();
    let (sin, cos) = libm::sincosf(0.14);
    (turned.camera.forward, turned.camera.right) = (
        cos * scene.camera.forward + sin * scene.camera.right,
        cos * scene.camera.right - sin * scene.camera.forward,
    );
    let cache = PlanCache::default();
    let [alone, _, after] = [&scene, &turned, &scene].map(|scene| plan(&cache, scene, &options));
    assert!(!Arc::ptr_eq(&alone.horizon, &after.horizon));
    assert_same_draws(&after, &alone);
    assert!(after.lit_rocks.texels() == alone.lit_rocks.texels(), "faces of rocks and the map of the ground");
    assert!(after.lit_rocks.lists == alone.lit_rocks.lists);
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
        for (along, across) in [1.5, 2.5, 3.5]
            .into_iter()
            .flat_map(|along| [-1.5, -0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9, 1.5].map(|across| (along, across)))
        {
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
