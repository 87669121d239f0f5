//! A scene on the device: what is drawn of it for this picture, and the buffers that hold it.
//!
//! The draw list is made anew for each frame from a [`Selection`], near things first.

use std::ops::Range;
use std::sync::{Arc, Weak};
use std::time::Instant;

use glam::Mat4;
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

use crate::class::ClassId;
use crate::error::Result;
use crate::frame::Annotation;
use crate::gpu::Gpu;
use crate::gpu::growing_buffer::GrowingBuffer;
use crate::gpu::staging::StagingBuffer;
use crate::render::device::packing::Packing;
use crate::render::device::shader_structs::{CasterTile, FrameUniforms, HorizonLevel, Instance};
use crate::render::device::shading_bins::{LightingVariant, ShadingBin, ShadingBins};
use crate::render::device::timing::milliseconds;
use crate::render::lighting::gbuffer::{Background, GBuffer};
use crate::render::lighting::relief_bands::Bands;
use crate::render::resolve::pass;
use crate::render::resolve::tile_list::SkyStencil;
use crate::render::select::caster_grid::{CasterGrids, ShadowSources, caster_grid};
use crate::render::select::casters;
use crate::render::select::footprint::Footprint;
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::select::selection::{Selection, Slots, front_to_back};
use crate::render::settings::RenderSettings;
use crate::render::shadow::device::ShadowPass;
use crate::render::shadow::horizon::{self, HorizonMap};
use crate::render::shadow::host::{self, NewTile, ShadowMap};
use crate::render::visibility::geometry::Facets;
use crate::render::visibility::host::Stencil;
use crate::render::visibility::meshes::{Draw, Meshes};
use crate::scene::Scene;
use crate::scene::bounce::{Bounce, rms_slope};
use crate::scene::photometry::Photometry;
use crate::scene::sky::{DOME_LEVEL, STAR_LEVEL};
use crate::scene::terrain::Terrain;

/// The draws of a frame, in order: of what the device is to draw, as ranges among those of its [`Meshes`].
#[derive(Clone, Debug, Default)]
pub struct DrawList {
    /// Into the layers of the shadow atlas: whole meshes.
    pub casters: Range<usize>,
    /// What is seen, by how it is lit, in the order in which it is drawn: near things before what they may cover.
    pub batches: Vec<DrawBatch>,
}

/// What is lit by one draw of the lighting pass.
#[derive(Clone, Debug)]
pub struct DrawBatch {
    /// Its number among those of the picture.
    pub group: ShadingBin,
    /// How.
    pub lit: LightingVariant,
    /// The slot of the instance that it is, unless each sample tells.
    pub instance: u32,
    /// Its slot among the reliefs below the mesh.
    pub relief: u32,
    /// What shows it, if the device is to draw that.
    pub draws: Range<usize>,
    /// Where it may be on the picture; nowhere if nothing shows it.
    pub bounds: ScreenBounds,
}

/// Everything of a scene that lies on the device. Buffers are kept and grow from frame to frame.
#[derive(Debug)]
pub struct GpuScene {
    /// What to draw.
    pub draws: DrawList,
    /// If the device is to draw any: the meshes.
    pub meshes: Meshes,
    /// `FrameUniforms`.
    pub frame: GrowingBuffer,
    /// `ReliefUniforms`, each in a slot of its own.
    pub relief: GrowingBuffer,
    /// `Instance`s, each in a slot of its own.
    pub instances: GrowingBuffer,
    /// `CasterTile`s.
    pub tiles: GrowingBuffer,
    /// Which casters a place must ask.
    pub caster_grid: GrowingBuffer,
    /// Columns and rows of the shadow map and of each of the layers that it is made of.
    pub atlas_px: [u32; 2],
    /// If this program draws the map: what the device has of it, and what it is to be given.
    shadow_map: ShadowMap,
    new_tiles: Vec<NewTile>,
    /// If this program finds what samples show: of what, and it; kept for their memory.
    facets: Facets,
    stencil: Stencil,
    /// If this program found the dome in every sample that shows nothing else: it, and it is not drawn.
    pub background: Option<Background>,
    /// What this program drew.
    pub drawn_here: DrawnHere,
    /// Triangles drawn of what is seen.
    pub drawn_triangles: u64,
    bounce: KeptBounce,
    /// The ground's horizon; kept for its memory.
    horizon_map: HorizonMap,
    /// The same on the device, two heights a texel.
    pub horizon: Option<(wgpu::Texture, wgpu::TextureView)>,
    /// Bytes written to the device for the last frame.
    pub uploaded_bytes: u64,
}

/// What sunlit ground lights, and of which ground, by which laws, under how high a sun.
#[derive(Debug, Default)]
struct KeptBounce {
    of: Option<(Weak<Terrain>, Photometry, f32)>,
    bounce: Bounce,
}

impl KeptBounce {
    fn of(&mut self, scene: &Scene) -> Bounce {
        let (laws, sine) = (scene.photometry, scene.sun.direction.z);
        let is_kept = self.of.as_ref().is_some_and(|(terrain, kept_laws, kept_sine)| {
            terrain.as_ptr() == Arc::as_ptr(&scene.terrain) && *kept_laws == laws && *kept_sine == sine
        });
        if !is_kept {
            self.bounce = Bounce::new(&laws, rms_slope(&scene.terrain), f64::from(sine));
            self.of = Some((Arc::downgrade(&scene.terrain), laws, sine));
        }
        self.bounce
    }
}

/// What the room for new tiles of the shadow map is a multiple of, bytes: frames differ a little in what they need.
const TILES_BYTES: usize = 1 << 20;

/// What is left to this program, which a device could do.
#[derive(Clone, Copy, Debug)]
pub struct Ways {
    /// The shadow map is drawn by this program ([`crate::render::shadow::host`]).
    pub own_shadow_map: bool,
    /// What samples show is drawn by this program ([`crate::render::visibility::host`]).
    pub own_visibility: bool,
    /// What is drawn so is told apart by what can shade it, to be lit by programs that do no more than that: no plane changes
    /// by a bit.
    pub by_shades: bool,
    /// The device takes a group's draws in one command: no plane changes by a bit.
    pub multi_draw: bool,
}

/// What this program drew of a frame, and how long each took, milliseconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct DrawnHere {
    /// The shadow map.
    pub shadow_map_ms: Option<f64>,
    /// What samples show.
    pub visibility_ms: Option<f64>,
}

/// Bytes from one of several uniforms in a buffer to the next: by WebGPU's default limits, bindings start at multiples of
/// 256.
#[must_use]
pub const fn slot_stride<T>() -> u32 {
    size_of::<T>().next_multiple_of(256) as u32
}

/// Uniforms, each in its slot.
fn slots<T: bytemuck::NoUninit>(uniforms: &[T]) -> Vec<u8> {
    let stride = slot_stride::<T>() as usize;
    let mut bytes = vec![0; stride * uniforms.len()];
    for (slot, uniforms) in bytes.chunks_exact_mut(stride).zip(uniforms) {
        slot[..size_of::<T>()].copy_from_slice(bytemuck::bytes_of(uniforms));
    }
    bytes
}

impl Default for GpuScene {
    fn default() -> Self {
        Self {
            draws: DrawList::default(),
            meshes: Meshes::default(),
            frame: GrowingBuffer::new("frame/uniforms", BufferUsages::UNIFORM),
            relief: GrowingBuffer::new("scene/relief", BufferUsages::UNIFORM),
            instances: GrowingBuffer::new(
                "scene/instances",
                BufferUsages::UNIFORM.union(BufferUsages::STORAGE),
            ),
            tiles: GrowingBuffer::new("shadow/tiles", BufferUsages::STORAGE),
            caster_grid: GrowingBuffer::new("shadow/caster_grid", BufferUsages::STORAGE),
            atlas_px: [0; 2],
            shadow_map: ShadowMap::default(),
            new_tiles: Vec::new(),
            facets: Facets::default(),
            stencil: Stencil::default(),
            background: None,
            drawn_here: DrawnHere::default(),
            drawn_triangles: 0,
            bounce: KeptBounce::default(),
            horizon_map: HorizonMap::default(),
            horizon: None,
            uploaded_bytes: 0,
        }
    }
}

impl GpuScene {
    /// Chooses what is drawn of `scene` with these settings and writes it to the device.
    pub fn upload(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        settings: &RenderSettings,
        picture_size: [u32; 2],
        ways: Ways,
    ) {
        self.uploaded_bytes = 0;
        let mut selection = Selection::new(scene, settings);
        self.drawn_here = DrawnHere::default();
        if ways.own_shadow_map {
            let start = Instant::now();
            self.new_tiles = self.shadow_map.place(scene, &mut selection);
            self.atlas_px = self.shadow_map.size_px();
            self.drawn_here.shadow_map_ms = Some(milliseconds(start.elapsed()));
        } else {
            self.shadow_map = ShadowMap::default();
            self.atlas_px = casters::atlas_size_px(&selection.casters);
        }
        let footprint = Footprint::new(scene, &selection);
        let is_new = self.horizon_map.update(&scene.terrain, &scene.sun, &footprint);
        let casters = &selection.casters;
        let caster_grid = caster_grid(scene, casters, self.horizon_map.shadowed_ground(), &footprint);
        let bands = Bands::new(scene, &selection, settings);
        self.uploaded_bytes += self.relief.write(gpu, &slots(&bands.bands));
        let slots = selection.slots();
        self.uploaded_bytes += self.instances.write(gpu, &self::slots(&instances(scene, settings, slots)));
        let mut seen = all_groups(&bands, slots);
        self.background = None;
        self.draws = DrawList::default();
        if ways.own_visibility {
            let start = Instant::now();
            self.facets.find(scene, &selection, settings, &caster_grid, &bands, ways.by_shades);
            for mesh in self.facets.meshes() {
                for (group, bounds) in mesh.groups.iter().zip(mesh.bounds) {
                    let seen = &mut seen[usize::from(self.facets.groups().merge_bands(*group))];
                    seen.bounds = seen.bounds.union(bounds);
                }
            }
            self.drawn_triangles = self.facets.meshes().iter().map(|mesh| mesh.facets.len() as u64).sum();
            self.drawn_here.visibility_ms = Some(milliseconds(start.elapsed()));
        }
        if !(ways.own_shadow_map && ways.own_visibility) {
            self.uploaded_bytes += self.meshes.upload(gpu, scene, &selection);
            let draws = self.list_draws(scene, settings, &bands, slots, &mut seen);
            self.uploaded_bytes += self.meshes.set_draws(gpu, draws, ways.multi_draw);
        }
        self.draws.batches = seen;
        self.draws.batches.retain(|seen| seen.bounds != ScreenBounds::EMPTY);
        let tiles: Vec<CasterTile> = casters.iter().map(|caster| caster.tile).collect();
        self.uploaded_bytes += self.tiles.write(gpu, &tiles);
        self.uploaded_bytes += self.caster_grid.write(gpu, &caster_grid);
        let bounce = self.bounce.of(scene);
        let uniforms =
            frame_uniforms(scene, settings, picture_size, &self.horizon_map, self.atlas_px, &bounce);
        self.uploaded_bytes += self.frame.write(gpu, &[uniforms]);
        self.upload_horizon(gpu, is_new);
    }

    /// Draws what is new in the shadow map of the scene that was uploaded last and gives it to the device, unless that is to draw
    /// it.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub(super) fn give_shadow_map(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        pass: &ShadowPass,
        staging: &mut Option<StagingBuffer>,
    ) -> Result<()> {
        let Some(shadow_map_ms) = &mut self.drawn_here.shadow_map_ms else { return Ok(()) };
        let start = Instant::now();
        let (parts, bytes) = host::parts(&self.new_tiles);
        if bytes > 0 {
            let room = bytes.next_multiple_of(TILES_BYTES);
            let staging = StagingBuffer::with_capacity(staging, gpu, "shadow/staging", room)?;
            staging.write(gpu, |room| host::draw(scene, &self.new_tiles, room))?;
            staging.copy_to(gpu, pass.texture(), &parts)?;
        }
        self.uploaded_bytes += bytes as u64;
        *shadow_map_ms += milliseconds(start.elapsed());
        Ok(())
    }

    /// Draws what the samples show of the scene that was uploaded last and gives it to the device, unless that is to draw it.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Device`].
    pub(super) fn give_visible(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        gbuffer: &mut GBuffer,
        staging: &mut Option<StagingBuffer>,
    ) -> Result<()> {
        let Some(visibility_ms) = &mut self.drawn_here.visibility_ms else { return Ok(()) };
        let start = Instant::now();
        self.uploaded_bytes += gbuffer.give(gpu, staging, &self.facets, &mut self.stencil)?;
        if !self.stencil.has_holes {
            self.background = Some(Background { radiance: scene.sky.radiance, class: ClassId::SKY });
            self.draws.batches.retain(|seen| seen.group != self.facets.groups().dome());
        }
        *visibility_ms += milliseconds(start.elapsed());
        Ok(())
    }

    /// What samples show, if this program drew it and there are none that show nothing.
    #[must_use]
    pub(super) fn shown(&self, gbuffer: &GBuffer) -> Option<SkyStencil<'_>> {
        self.background.as_ref().map(|_| SkyStencil {
            stencil: &self.stencil.values,
            dome: self.facets.groups().dome() + 1,
            samples_per_side: gbuffer.samples_per_side as usize,
        })
    }

    /// What the device is to draw, whole meshes, which it has: casters, and ground, rocks and sky for `seen`, all groups.
    fn list_draws(
        &mut self,
        scene: &Scene,
        settings: &RenderSettings,
        bands: &Bands,
        slots: Slots<'_>,
        seen: &mut [DrawBatch],
    ) -> Vec<Draw> {
        let (selection, meshes) = (slots.selection(), &self.meshes);
        let mut draws = Vec::new();
        if self.drawn_here.shadow_map_ms.is_none() {
            draws.extend((0..).zip(&selection.rocks).filter_map(|(place, selected)| {
                let (_, level) = selected.caster?;
                Some(meshes.rock(selected.rock, level, Slots::rock(place)))
            }));
        }
        self.draws.casters = 0..draws.len();
        if self.drawn_here.visibility_ms.is_none() {
            let mut shown: Vec<(ShadingBin, Draw)> = Vec::new();
            let mut show = |group: ShadingBin, draw: Draw, bounds: ScreenBounds| {
                let seen = &mut seen[usize::from(group)];
                seen.bounds = seen.bounds.union(bounds);
                shown.push((group, draw));
            };
            let rocks = (0..).zip(&selection.rocks).filter_map(|(place, selected)| {
                let rock = &scene.rocks[selected.rock];
                let draw = meshes.rock(selected.rock, selected.visible_level?, Slots::rock(place));
                let bounds = ScreenBounds::of_sphere(scene, settings, rock.centre, rock.radius_m);
                Some((selected.nearest_m, (draw, bounds)))
            });
            for (_, (draw, bounds)) in front_to_back(rocks) {
                show(ShadingBins::rocks(ShadowSources::GroundAndRocks), draw, bounds);
            }
            let blocks = selection.blocks.iter().map(|&(block, nearest_m)| (nearest_m, block));
            for (_, block) in front_to_back(blocks) {
                let group = ShadingBins::ground(bands.of_block(block), ShadowSources::GroundAndRocks);
                show(group, meshes.block(block, Slots::GROUND), ScreenBounds::UNBOUNDED);
            }
            let groups = ShadingBins::new(bands.bands.len());
            let sky =
                [(groups.stars(), STAR_LEVEL, slots.stars()), (groups.dome(), DOME_LEVEL, slots.dome())];
            for (group, level, slots) in sky.into_iter().filter(|(.., slots)| !slots.is_empty()) {
                show(group, meshes.unit_spheres(level, slots), ScreenBounds::UNBOUNDED);
            }
            self.drawn_triangles = shown.iter().map(|(_, draw)| draw.triangles()).sum();
            // Those of a group stay in their order.
            shown.sort_by_key(|(group, _)| *group);
            for of_group in shown.chunk_by(|a, b| a.0 == b.0) {
                let first = draws.len();
                draws.extend(of_group.iter().map(|(_, draw)| *draw));
                seen[usize::from(of_group[0].0)].draws = first..draws.len();
            }
        }
        draws
    }

    fn upload_horizon(&mut self, gpu: &Gpu, is_new: bool) {
        let map = &self.horizon_map;
        let (width, height) = (map.width, map.height());
        let fits = |texture: &wgpu::Texture| texture.width() >= width && texture.height() >= height;
        let is_there = self.horizon.as_ref().is_some_and(|(texture, _)| fits(texture));
        if !is_there {
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
            self.horizon =
                Some(gpu.texture("shadow/horizon", [width, height], TextureFormat::Rg32Float, usage));
        }
        if let Some((texture, _)) = self.horizon.as_ref().filter(|_| is_new || !is_there) {
            gpu.write_texels(texture, [width, height], &map.heights_m);
            self.uploaded_bytes += size_of_val(&map.heights_m[..]) as u64;
        }
    }

    /// After an error: what was written to the device may not be there.
    pub fn forget(&mut self) {
        self.horizon = None;
        self.meshes = Meshes::default();
        self.shadow_map = ShadowMap::default();
    }
}

/// The things of a picture, by their slots.
fn instances(scene: &Scene, settings: &RenderSettings, slots: Slots<'_>) -> Vec<Instance> {
    let selection = slots.selection();
    let photometry = &scene.photometry;
    let (soil_surge, rock_surge) = (photometry.soil.b_s0 as f32, photometry.rock_b_s0 as f32);
    let at_normal = |surge: f32| photometry.at_normal(f64::from(surge)) as f32;
    let focal_px = scene.camera.focal_px(settings.size[0]) as f32;
    let mut instances = vec![Instance {
        scale: 1.0,
        colour: scene.regolith.albedo / at_normal(soil_surge),
        surge: soil_surge,
        roughness: scene.regolith.roughness,
        class_id: ClassId::REGOLITH.0.into(),
        ..Default::default()
    }];
    let rock_at_normal = at_normal(rock_surge);
    instances.extend(selection.rocks.iter().map(|selected| {
        let rock = &scene.rocks[selected.rock];
        let counts = scene.label_rule.counts(rock, scene.camera.eye, focal_px);
        let tile = selected.caster.map_or_else(Default::default, |(tile, _)| selection.casters[tile].tile);
        Instance {
            origin: rock.centre,
            scale: 1.0,
            colour: rock.material.albedo / rock_at_normal,
            roughness: rock.material.roughness,
            class_id: if counts { ClassId::ROCK } else { ClassId::REGOLITH }.0.into(),
            instance_id: if counts { rock.index + 1 } else { 0 },
            surge: rock_surge,
            tile_half_extent_m: tile.half_extent_m,
            dust: scene.regolith.albedo / rock_at_normal,
            dust_above: rock.dust_above,
            tile_origin_px: tile.origin_px,
            tile_size_px: tile.size_px,
            reserved: 0,
        }
    }));
    let in_sky = |origin, scale, colour| Instance {
        origin,
        scale,
        colour,
        class_id: ClassId::SKY.0.into(),
        ..Default::default()
    };
    instances.extend(selection.stars.iter().map(|&star| {
        let star = scene.sky.stars[star];
        in_sky(star.centre, star.radius_m, scene.sky.star_radiance)
    }));
    instances.push(in_sky(scene.sky.centre, scene.sky.radius_m, scene.sky.radiance));
    instances
}

/// All groups of a picture, by their numbers, of which nothing is shown yet.
fn all_groups(bands: &Bands, slots: Slots<'_>) -> Vec<DrawBatch> {
    let groups = ShadingBins::new(bands.bands.len());
    let instance = |group| match group {
        _ if group == groups.stars() => slots.stars().start,
        _ if group == groups.dome() => slots.dome().start,
        // Of rocks, each sample tells which.
        _ => Slots::GROUND,
    };
    let all = (0..).zip(groups.all()).map(|(group, (lit, band))| DrawBatch {
        group,
        lit,
        instance: instance(group),
        relief: band as u32,
        draws: 0..0,
        bounds: ScreenBounds::EMPTY,
    });
    all.collect()
}

fn frame_uniforms(
    scene: &Scene,
    settings: &RenderSettings,
    picture_size: [u32; 2],
    horizon: &HorizonMap,
    [atlas_width_px, atlas_layer_px]: [u32; 2],
    bounce: &Bounce,
) -> FrameUniforms {
    let (camera, sun) = (&scene.camera, &scene.sun);
    let [sun_right, sun_up] = sun.right_and_up();
    let clip_from_offset = camera.clip_from_world(settings.size) * Mat4::from_translation(camera.eye);
    let packing = Packing::new(picture_size, settings.annotations);
    let lens = camera.lens;
    let grids = CasterGrids::new(&scene.terrain);
    let photometry = &scene.photometry;
    let exitance = photometry.exitance(f64::from(sun.direction.z)) as f32;
    let mut levels = [HorizonLevel::default(); horizon::MAX_LEVELS];
    levels[..horizon.levels.len()].copy_from_slice(&horizon.levels);
    FrameUniforms {
        clip_from_offset,
        ray_from_sample: settings.rays(camera).map(|ray| ray.extend(0.0).into()),
        eye: camera.eye,
        exposure: pass::exposure(camera.exposure_ev),
        sun_direction: sun.direction,
        sun_tan_half_angle: sun.tan_half_angle(),
        sun_irradiance: sun.irradiance,
        atlas_layer_px: atlas_layer_px as f32,
        sun_right,
        atlas_width_px: atlas_width_px as f32,
        sun_up,
        bounce_share: photometry.diffuse_reflectance() as f32,
        ground_radiance: scene.regolith.albedo * sun.irradiance * exitance / std::f32::consts::PI,
        horizon_base_m: horizon.base_m,
        bounce_on_rock: bounce.on_rock,
        bounce_on_ground: bounce.on_ground,
        bounce_in_shadow: bounce.in_shadow,
        sky_radiance: scene.sky.radiance + scene.sky.earthshine,
        caster_cells: grids.cells,
        horizon_towards: horizon.towards,
        horizon_centre: horizon.centre,
        caster_centre: grids.centre,
        picture_size_px: picture_size,
        drawn_size_px: settings.size,
        caster_half_m: grids.half_m,
        caster_levels: grids.levels,
        horizon_levels: horizon.levels.len() as u32,
        hapke_w: photometry.soil.w as f32,
        hapke_b: photometry.soil.b as f32,
        hapke_c: photometry.soil.c as f32,
        hapke_h_s: photometry.soil.h_s as f32,
        hapke_tan_theta_bar: libm::tan(photometry.soil.theta_bar_deg.to_radians()) as f32,
        lens_k: [lens.k1 as f32, lens.k2 as f32, lens.k3 as f32],
        focal_samples: settings.focal_samples(camera),
        lens_p: glam::Vec2::new(lens.p1 as f32, lens.p2 as f32),
        depth_at: packing.start(Annotation::Depth),
        normals_at: packing.start(Annotation::Normals),
        instances_at: packing.start(Annotation::Instances),
        hidden_at: packing.start(Annotation::Shadow),
        radiance_at: packing.start(Annotation::Hdr),
        coverage_at: packing.start(Annotation::Coverage),
        reserved: [0; 2],
        horizon: levels,
    }
}
