//! A scene on the device: what is drawn of it for this picture, and the buffers that hold it.
//!
//! The draw list is made anew for each frame from a [`Selection`], near things first.

use std::ops::Range;
use std::time::Instant;

use glam::Mat4;
use wgpu::{BufferUsages, IndexFormat, TextureFormat, TextureUsages};

use super::RenderSettings;
use super::facing::{Facing, Triangle};
use super::footprint::Footprint;
use super::horizon::{self, HorizonMap};
use super::relief::Bands;
use super::resolve::{self, Packing};
use super::scene_pass::Variant;
use super::selection::{Bounds, Selection, ground_blocks};
use super::shaders::{CasterTile, FrameUniforms, HorizonLevel, Instance};
use super::shadow::{self, CasterGrids, Shades};
use super::shadow_raster;
use crate::class::ClassId;
use crate::frame::{Annotation, Annotations};
use crate::gpu::Gpu;
use crate::scene::Scene;
use crate::scene::bounce::{Bounce, rms_slope};
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::photometry::Law;
use crate::scene::terrain::Layout;

/// Levels of the icospheres that dome and stars are drawn with.
const DOME_LEVEL: usize = 4;
const STAR_LEVEL: usize = 1;

/// One indexed draw.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Draw {
    /// Range in the index buffer.
    pub indices: Range<u32>,
    /// First vertex of the mesh.
    pub base_vertex: i32,
    /// Its slot in the instance buffer.
    pub instance: u32,
}

/// The draws of a frame, in order.
#[derive(Clone, Debug, Default)]
pub struct DrawList {
    /// Into the layers of the shadow atlas: whole meshes.
    pub casters: Vec<Draw>,
    /// What is seen, by how it is lit, in the order in which it is drawn: near things before what they may cover.
    pub seen: Vec<Seen>,
}

/// What is lit by one draw of the scene pass.
#[derive(Clone, Debug)]
pub struct Seen {
    /// How.
    pub lit: Lit,
    /// The slot of the instance that it is, unless each sample tells.
    pub instance: u32,
    /// Its slot among the reliefs below the mesh.
    pub relief: u32,
    /// What shows it.
    pub draws: Vec<Draw>,
    /// Where it may be on the picture.
    pub bounds: Bounds,
}

/// By which program samples are lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lit {
    /// Ground that these things can shade.
    Ground {
        /// What can shade it.
        shades: Shades,
    },
    /// Rocks that these things can shade.
    Rocks {
        /// What can shade them.
        shades: Shades,
    },
    /// Dome and stars.
    Sky,
}

/// Everything of a scene that lies on the device. Buffers are kept and grow from frame to frame.
#[derive(Debug)]
pub struct GpuScene {
    /// What to draw.
    pub draws: DrawList,
    /// Vertices of ground, unit spheres, rocks.
    pub vertices: Store,
    /// Triangles of the icosphere's levels, then of the ground's blocks.
    pub indices: Store,
    /// Triangles that were picked for this frame.
    picked: Store,
    is_picked: bool,
    /// Those triangles, kept for their memory.
    picked_triangles: Picked,
    /// `FrameUniforms`.
    pub frame: Store,
    /// `ReliefUniforms`, each in a slot of its own.
    pub relief: Store,
    law: Law,
    has_detail: bool,
    /// `Instance`s, each in a slot of its own.
    pub instances: Store,
    /// `CasterTile`s.
    pub tiles: Store,
    /// Which casters a place must ask.
    pub caster_grid: Store,
    /// Columns and rows of the shadow map and of each of the layers that it is made of.
    pub atlas_px: [u32; 2],
    /// The map, if this program drew it; kept for its memory.
    shadow_map: Vec<f32>,
    /// If this program drew it: how long it took.
    pub shadow_map_ms: Option<f64>,
    /// The ground's horizon, two heights a texel.
    pub horizon: Option<(wgpu::Texture, wgpu::TextureView)>,
    ground: Option<GroundBlocks>,
    sphere_levels: Vec<Range<u32>>,
    /// Bytes written to the device for the last frame.
    pub uploaded_bytes: u64,
}

/// Index ranges of the ground's blocks, for a number of columns and rows, and whether they are rings.
#[derive(Debug)]
struct GroundBlocks {
    cells: [u32; 3],
    blocks: Vec<Range<u32>>,
}

/// Triangles that are picked for a frame.
#[derive(Debug, Default)]
struct Picked {
    triangles: Vec<Triangle>,
}

impl Picked {
    /// Adds triangles and gives the range of their indices.
    fn add(&mut self, triangles: &[Triangle]) -> Range<u32> {
        let start = 3 * self.triangles.len() as u32;
        self.triangles.extend(triangles);
        start..start + 3 * triangles.len() as u32
    }
}

/// What is left to this program, which a device could do.
#[derive(Clone, Copy, Debug)]
pub struct Ways {
    /// Triangles that cannot be seen are left out one by one ([`super::facing`]): no plane changes by a bit.
    pub pick_triangles: bool,
    /// The shadow map is drawn ([`super::shadow_raster`]).
    pub own_shadow_map: bool,
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

/// A buffer that grows when more is written than it holds.
#[derive(Debug)]
pub struct Store {
    label: &'static str,
    usage: BufferUsages,
    buffer: Option<wgpu::Buffer>,
}

impl Store {
    const fn new(label: &'static str, usage: BufferUsages) -> Self {
        Self { label, usage, buffer: None }
    }

    /// The buffer.
    ///
    /// # Panics
    /// Before the first [`GpuScene::upload`].
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        self.buffer.as_ref().expect("a scene is uploaded before it is drawn")
    }

    /// Its first `bytes`, as a binding.
    #[must_use]
    pub fn first(&self, bytes: usize) -> wgpu::BindingResource<'_> {
        let size = wgpu::BufferSize::new(bytes as u64);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: self.buffer(), offset: 0, size })
    }

    /// Makes room for `bytes`; what the buffer held may be lost.
    fn reserve(&mut self, gpu: &Gpu, bytes: usize) {
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes as u64) {
            let room = (bytes as u64).next_power_of_two();
            self.buffer = Some(gpu.buffer(self.label, room, self.usage | BufferUsages::COPY_DST));
        }
    }

    fn write<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, data: &[T]) -> u64 {
        self.write_parts(gpu, &[data])
    }

    /// Writes one after the other.
    fn write_parts<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, parts: &[&[T]]) -> u64 {
        let bytes: usize = parts.iter().map(|part| size_of_val(*part)).sum();
        self.reserve(gpu, bytes);
        let size = wgpu::BufferSize::new(bytes as u64);
        // There is no view where something is wrong with the device, which it says itself.
        if let Some(mut view) = size.and_then(|size| gpu.queue.write_buffer_with(self.buffer(), 0, size)) {
            let mut start = 0;
            for part in parts {
                let part: &[u8] = bytemuck::cast_slice(part);
                view.slice(start..start + part.len()).copy_from_slice(part);
                start += part.len();
            }
        }
        bytes as u64
    }
}

impl Default for GpuScene {
    fn default() -> Self {
        Self {
            draws: DrawList::default(),
            vertices: Store::new("scene/vertices", BufferUsages::VERTEX),
            indices: Store::new("scene/indices", BufferUsages::INDEX),
            picked: Store::new("scene/picked_indices", BufferUsages::INDEX),
            is_picked: false,
            picked_triangles: Picked::default(),
            frame: Store::new("frame/uniforms", BufferUsages::UNIFORM),
            relief: Store::new("scene/relief", BufferUsages::UNIFORM),
            law: Law::Lambert,
            has_detail: false,
            instances: Store::new("scene/instances", BufferUsages::UNIFORM.union(BufferUsages::STORAGE)),
            tiles: Store::new("shadow/tiles", BufferUsages::STORAGE),
            caster_grid: Store::new("shadow/caster_grid", BufferUsages::STORAGE),
            atlas_px: [0; 2],
            shadow_map: Vec::new(),
            shadow_map_ms: None,
            horizon: None,
            ground: None,
            sphere_levels: Vec::new(),
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
        self.upload_indices(gpu, scene);
        let selection = Selection::new(scene, settings);
        let footprint = Footprint::new(scene, &selection.frustum);
        let horizon = HorizonMap::build(&scene.terrain, &scene.sun, &footprint);
        let casters = &selection.casters;
        let caster_grid = shadow::caster_grid(scene, casters, &horizon, &footprint);
        let facing = ways.pick_triangles.then(|| Facing::new(scene, &selection, settings, &caster_grid));
        let bands = Bands::new(scene, &selection, settings);
        self.uploaded_bytes += self.relief.write(gpu, &slots(&bands.bands));
        self.shadow_map_ms = None;
        if ways.own_shadow_map {
            let start = Instant::now();
            shadow_raster::draw(scene, &selection, &mut self.shadow_map);
            self.shadow_map_ms = Some(super::milliseconds(start.elapsed()));
            self.uploaded_bytes += size_of_val(&self.shadow_map[..]) as u64;
        }
        self.upload_things(gpu, scene, settings, &selection, &bands, facing.as_ref());
        let tiles: Vec<CasterTile> = casters.iter().map(|caster| caster.tile).collect();
        self.uploaded_bytes += self.tiles.write(gpu, &tiles);
        self.uploaded_bytes += self.caster_grid.write(gpu, &caster_grid);
        self.atlas_px = shadow::atlas_px(casters);
        let uniforms = frame_uniforms(scene, settings, picture_size, &horizon, self.atlas_px);
        self.uploaded_bytes += self.frame.write(gpu, &[uniforms]);
        (self.law, self.has_detail) = (scene.photometry.law, scene.relief.is_some());
        self.upload_horizon(gpu, &horizon);
    }

    /// The shadow map, unless the device is to draw it.
    #[must_use]
    pub fn shadow_map(&self) -> Option<&[f32]> {
        self.shadow_map_ms.map(|_| &self.shadow_map[..])
    }

    /// The indices of ground and rocks that are seen.
    #[must_use]
    pub const fn thing_indices(&self) -> (&Store, IndexFormat) {
        if self.is_picked { (&self.picked, IndexFormat::Uint16) } else { self.whole_indices() }
    }

    /// The indices of whole meshes, which casters and those of the sky are.
    #[must_use]
    pub const fn whole_indices(&self) -> (&Store, IndexFormat) {
        (&self.indices, IndexFormat::Uint32)
    }

    /// What the pipelines must be made for, to draw it with these annotations.
    #[must_use]
    pub(super) const fn variant(&self, annotations: Annotations) -> Variant {
        Variant { annotations, law: self.law, detail: self.has_detail }
    }

    /// Triangles drawn of what is seen.
    #[must_use]
    pub fn drawn_triangles(&self) -> u64 {
        let count = |d: &Draw| u64::from(d.indices.end - d.indices.start) / 3;
        self.draws.seen.iter().flat_map(|seen| &seen.draws).map(count).sum()
    }

    /// The index buffer depends on the ground's layout alone.
    fn upload_indices(&mut self, gpu: &Gpu, scene: &Scene) {
        let terrain = &scene.terrain;
        let cells = [terrain.columns, terrain.rows, u32::from(matches!(terrain.layout, Layout::Rings(_)))];
        if self.ground.as_ref().is_some_and(|ground| ground.cells == cells) {
            return;
        }
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        let mut range = |more: &mut dyn Iterator<Item = [u32; 3]>| {
            let start = 3 * triangles.len() as u32;
            triangles.extend(more);
            start..3 * triangles.len() as u32
        };
        self.sphere_levels =
            Icosphere::shared().triangles.iter().map(|level| range(&mut level.iter().copied())).collect();
        let blocks = ground_blocks(terrain)
            .map(|[columns, rows]| range(&mut scene.terrain.block_triangles(columns, rows)))
            .collect();
        self.ground = Some(GroundBlocks { cells, blocks });
        self.uploaded_bytes += self.indices.write(gpu, triangles.as_flattened());
    }

    /// Vertices, instances and draws of ground, rocks and sky.
    fn upload_things(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        settings: &RenderSettings,
        selection: &Selection,
        bands: &Bands,
        facing: Option<&Facing>,
    ) {
        let mut draws = DrawList::default();
        let mut picked = std::mem::take(&mut self.picked_triangles);
        picked.triangles.clear();
        let sphere: Vec<Vertex> = Icosphere::shared().directions[..Icosphere::vertex_count(DOME_LEVEL)]
            .iter()
            .map(|&d| Vertex { position: d, normal: d })
            .collect();
        let mut uploads: Vec<&[Vertex]> = vec![&sphere];
        let mut next_vertex = sphere.len();
        let mut upload = |vertices| {
            uploads.push(vertices);
            let first = next_vertex;
            next_vertex += vertices.len();
            first as i32
        };
        let photometry = &scene.photometry;
        let (soil_surge, rock_surge) = (photometry.soil.b_s0 as f32, photometry.rock_b_s0 as f32);
        let at_normal = |surge: f32| photometry.at_normal(f64::from(surge)) as f32;
        let focal_px = scene.camera.focal_px(settings.size[0]) as f32;
        // Ground.
        let mut instances = vec![Instance {
            scale: 1.0,
            colour: scene.regolith.albedo / at_normal(soil_surge),
            surge: soil_surge,
            roughness: scene.regolith.roughness,
            class_id: ClassId::REGOLITH.0.into(),
            ..Default::default()
        }];
        // By what can shade it, for each band.
        let mut ground: Vec<[Seen; 3]> = (0..bands.bands.len() as u32)
            .map(|relief| {
                [Shades::Nothing, Shades::Ground, Shades::Casters].map(|shades| Seen {
                    lit: Lit::Ground { shades },
                    instance: 0,
                    relief,
                    draws: Vec::new(),
                    bounds: Bounds::NOWHERE,
                })
            })
            .collect();
        let mut blocks: Vec<(usize, &(usize, f32))> = selection.blocks.iter().enumerate().collect();
        blocks.sort_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let whole_ground = if facing.is_none() { upload(&scene.terrain.vertices) } else { 0 };
        for (place, &(block, _)) in blocks {
            let band = bands.of_block(block);
            let mut add = |shades: usize, indices, base_vertex, bounds: Bounds| {
                let seen = &mut ground[band][shades];
                seen.draws.push(Draw { indices, base_vertex, instance: 0 });
                seen.bounds = seen.bounds.union(bounds);
            };
            if let Some(facing) = facing {
                let block = &facing.ground[place];
                let base = upload(&block.vertices);
                for (shades, chosen) in block.by_shades.iter().enumerate() {
                    if !chosen.triangles.is_empty() {
                        add(shades, picked.add(&chosen.triangles), base, chosen.bounds);
                    }
                }
            } else if let Some(known) = &self.ground {
                add(Shades::Casters as usize, known.blocks[block].clone(), whole_ground, Bounds::ANYWHERE);
            }
        }
        let mut rocks = [const { Vec::new() }; 2];
        let mut rock_bounds = [Bounds::NOWHERE; 2];
        // Rocks: an instance each; as many vertices as were picked, and of whole meshes as the finer of its uses needs.
        let rock_at_normal = at_normal(rock_surge);
        for (place, selected) in selection.rocks.iter().enumerate() {
            let rock = &scene.rocks[selected.rock];
            let instance = instances.len() as u32;
            let casts = selected.caster.map(|(_, level)| level).filter(|_| self.shadow_map_ms.is_none());
            let whole_level = selected.seen_level.filter(|_| facing.is_none()).max(casts);
            let whole = |level: Option<usize>| level.map_or(0..0, |level| self.sphere_levels[level].clone());
            let whole_base =
                whole_level.map_or(0, |level| upload(&rock.vertices[..Icosphere::vertex_count(level)]));
            let draw = |indices, base_vertex| Draw { indices, base_vertex, instance };
            draws.casters.push(draw(whole(casts), whole_base));
            let (seen, base) = if let Some(facing) = facing {
                let chosen = &facing.rocks[place];
                (chosen.seen.each_ref().map(|triangles| picked.add(triangles)), upload(&chosen.vertices))
            } else {
                ([0..0, whole(selected.seen_level)], whole_base)
            };
            let bounds = Bounds::of_ball(scene, settings, rock.centre, rock.radius_m);
            for ((list, around), indices) in rocks.iter_mut().zip(&mut rock_bounds).zip(seen) {
                if !indices.is_empty() {
                    list.push((selected.nearest_m, draw(indices, base)));
                    *around = around.union(bounds);
                }
            }
            let counts = scene.label_rule.counts(rock, scene.camera.eye, focal_px);
            let tile =
                selected.caster.map_or_else(Default::default, |(tile, _)| selection.casters[tile].tile);
            instances.push(Instance {
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
                slot: 0,
            });
        }
        // Rocks before the ground that they cover, all before the sky.
        let lit_rocks = [Shades::Nothing, Shades::Casters].into_iter().zip(rocks).zip(rock_bounds).rev();
        draws.seen.extend(lit_rocks.map(|((shades, list), bounds)| Seen {
            lit: Lit::Rocks { shades },
            instance: 0,
            relief: 0,
            draws: near_to_far(list),
            bounds,
        }));
        draws.seen.extend(ground.into_iter().flatten());
        // Sky: stars before the dome that they cover.
        let in_sky = |origin, scale, colour| Instance {
            origin,
            scale,
            colour,
            class_id: ClassId::SKY.0.into(),
            ..Default::default()
        };
        let first_star = instances.len() as u32;
        instances.extend(selection.stars.iter().map(|&star| {
            let star = scene.sky.stars[star];
            in_sky(star.centre, star.radius_m, scene.sky.star_radiance)
        }));
        let dome = instances.len() as u32;
        instances.push(in_sky(scene.sky.centre, scene.sky.radius_m, scene.sky.radiance));
        for (slot, instance) in (0..).zip(&mut instances) {
            instance.slot = slot;
        }
        for (level, range) in [(STAR_LEVEL, first_star..dome), (DOME_LEVEL, dome..dome + 1)] {
            let (instance, indices) = (range.start, &self.sphere_levels[level]);
            let draw = |instance| Draw { indices: indices.clone(), base_vertex: 0, instance };
            draws.seen.push(Seen {
                lit: Lit::Sky,
                instance,
                relief: 0,
                draws: range.map(draw).collect(),
                bounds: Bounds::ANYWHERE,
            });
        }
        draws.seen.retain(|seen| seen.draws.iter().any(|draw| !draw.indices.is_empty()));
        assert!(draws.seen.len() < 256, "the stencil tells them apart");
        self.draws = draws;
        self.uploaded_bytes += self.vertices.write_parts(gpu, &uploads);
        self.uploaded_bytes += self.instances.write(gpu, &slots(&instances));
        self.is_picked = facing.is_some();
        if self.is_picked {
            // What is written has a whole number of words.
            if !picked.triangles.len().is_multiple_of(2) {
                picked.triangles.push([0; 3]);
            }
            self.uploaded_bytes += self.picked.write(gpu, picked.triangles.as_flattened());
        }
        self.picked_triangles = picked;
    }

    fn upload_horizon(&mut self, gpu: &Gpu, map: &HorizonMap) {
        let (width, height) = (map.width, map.height());
        let fits = |texture: &wgpu::Texture| texture.width() >= width && texture.height() >= height;
        if !self.horizon.as_ref().is_some_and(|(texture, _)| fits(texture)) {
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
            self.horizon =
                Some(gpu.texture("shadow/horizon", [width, height], TextureFormat::Rg32Float, usage));
        }
        if let Some((texture, _)) = &self.horizon {
            let bytes: &[u8] = bytemuck::cast_slice(&map.heights_m);
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(8 * width),
                rows_per_image: None,
            };
            let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
            gpu.queue.write_texture(texture.as_image_copy(), bytes, layout, size);
            self.uploaded_bytes += bytes.len() as u64;
        }
    }
}

fn frame_uniforms(
    scene: &Scene,
    settings: &RenderSettings,
    picture_size: [u32; 2],
    horizon: &HorizonMap,
    [atlas_width_px, atlas_layer_px]: [u32; 2],
) -> FrameUniforms {
    let (camera, sun) = (&scene.camera, &scene.sun);
    let [sun_right, sun_up] = sun.right_and_up();
    let clip_from_offset = camera.clip_from_world(settings.size) * Mat4::from_translation(camera.eye);
    let packing = Packing::new(picture_size, settings.annotations);
    let lens = camera.lens;
    let grids = CasterGrids::new(&scene.terrain);
    let photometry = &scene.photometry;
    let exitance = photometry.exitance(f64::from(sun.direction.z)) as f32;
    let bounce = Bounce::new(photometry, rms_slope(&scene.terrain), f64::from(sun.direction.z));
    let mut levels = [HorizonLevel::default(); horizon::MOST_LEVELS];
    levels[..horizon.levels.len()].copy_from_slice(&horizon.levels);
    FrameUniforms {
        clip_from_offset,
        ray_from_sample: ray_from_sample(scene, settings),
        eye: camera.eye,
        exposure: resolve::exposure(camera.exposure_ev),
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
        depth_scale_m: camera.near_m * camera.far_m / (camera.far_m - camera.near_m),
        depth_offset: camera.near_m / (camera.far_m - camera.near_m),
        depth_at: packing.start(Annotation::Depth),
        normals_at: packing.start(Annotation::Normals),
        instances_at: packing.start(Annotation::Instances),
        hidden_at: packing.start(Annotation::Shadow),
        radiance_at: packing.start(Annotation::Hdr),
        coverage_at: packing.start(Annotation::Coverage),
        horizon: levels,
    }
}

/// The draws by rising distance.
fn near_to_far(mut list: Vec<(f32, Draw)>) -> Vec<Draw> {
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    list.into_iter().map(|(_, draw)| draw).collect()
}

/// Places a metre along the axis that samples show, metres from the eye: of sample (0, 0), and how it moves with a column
/// and a row.
fn ray_from_sample(scene: &Scene, settings: &RenderSettings) -> [[f32; 4]; 3] {
    let camera = &scene.camera;
    let aspect = settings.size[0] as f32 / settings.size[1] as f32;
    let sample = settings.sample_angle(camera);
    let corner = camera.forward - camera.tan_half_fov * (camera.right - camera.up / aspect);
    [corner, sample * camera.right, -sample * camera.up].map(|v| v.extend(0.0).into())
}
