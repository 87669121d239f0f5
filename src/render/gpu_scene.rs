//! A scene on the device: what is drawn of it for this picture, and the buffers that hold it.
//!
//! The draw list is made anew for each frame: ground blocks and rocks that the camera can see, near ones first,
//! each rock at the coarsest level that stays within a quarter of a pixel of its authored outline; and every rock
//! whose shadow can be seen, for the shadow atlas.

use std::ops::Range;

use glam::{Mat4, Vec3, Vec4};
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

use super::shaders::{CasterTile, FrameUniforms, Instance};
use super::shadow::{self, Caster, HorizonMap};
use super::{RenderSettings, resolve};
use crate::class::ClassId;
use crate::gpu::Gpu;
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::sky::{DOME_RADIANCE, STAR_RADIANCE};

/// Largest distance of a caster's drawn outline from the authored one, texels of its tile.
const CASTER_ERROR_PX: f32 = 0.25;
/// Cells along a side of a block of ground that is culled as one.
const BLOCK_CELLS: u32 = 30;
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
    /// Range in the instance buffer.
    pub instances: Range<u32>,
}

/// The draws of a frame, in order.
#[derive(Clone, Debug, Default)]
pub struct DrawList {
    /// Into the shadow atlas.
    pub casters: Vec<Draw>,
    /// Ground and rocks, near to far.
    pub surfaces: Vec<Draw>,
    /// Stars, then the dome.
    pub sky: Vec<Draw>,
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
    /// `FrameUniforms`.
    pub frame: Store,
    /// `Instance`s.
    pub instances: Store,
    /// `CasterTile`s.
    pub tiles: Store,
    /// Which casters a place must ask.
    pub caster_grid: Store,
    /// The ground's horizon, two heights a texel.
    pub horizon: Option<(wgpu::Texture, wgpu::TextureView)>,
    ground: Option<GroundBlocks>,
    sphere_levels: Vec<Range<u32>>,
    /// Bytes written to the device for the last frame.
    pub uploaded_bytes: u64,
}

/// Index ranges of the ground's blocks, for a number of cells.
#[derive(Debug)]
struct GroundBlocks {
    cells: u32,
    blocks: Vec<(Range<u32>, [Range<u32>; 2])>,
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

    /// Makes room for `bytes`; what the buffer held may be lost.
    fn reserve(&mut self, gpu: &Gpu, bytes: usize) {
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes as u64) {
            let room = (bytes as u64).next_power_of_two();
            self.buffer = Some(gpu.buffer(self.label, room, self.usage | BufferUsages::COPY_DST));
        }
    }

    fn write_at<T: bytemuck::NoUninit>(&self, gpu: &Gpu, offset: usize, data: &[T]) -> u64 {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        gpu.queue.write_buffer(self.buffer(), offset as u64, bytes);
        bytes.len() as u64
    }

    fn write<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, data: &[T]) -> u64 {
        self.reserve(gpu, std::mem::size_of_val(data));
        self.write_at(gpu, 0, data)
    }
}

impl Default for GpuScene {
    fn default() -> Self {
        Self {
            draws: DrawList::default(),
            vertices: Store::new("scene/vertices", BufferUsages::VERTEX),
            indices: Store::new("scene/indices", BufferUsages::INDEX),
            frame: Store::new("frame/uniforms", BufferUsages::UNIFORM),
            instances: Store::new("scene/instances", BufferUsages::STORAGE),
            tiles: Store::new("shadow/tiles", BufferUsages::STORAGE),
            caster_grid: Store::new("shadow/caster_grid", BufferUsages::STORAGE),
            horizon: None,
            ground: None,
            sphere_levels: Vec::new(),
            uploaded_bytes: 0,
        }
    }
}

impl GpuScene {
    /// Chooses what is drawn of `scene` with these settings and writes it to the device.
    pub fn upload(&mut self, gpu: &Gpu, scene: &Scene, settings: &RenderSettings) {
        self.uploaded_bytes = 0;
        self.upload_indices(gpu, scene);
        let frustum = Frustum::new(&scene.camera.clip_from_world(settings.size));
        let focal_px = scene.camera.focal_px(settings.size[0]) as f32;
        let casters = shadow::casters(scene, &frustum, 1.0 / focal_px);
        let horizon = HorizonMap::build(&scene.terrain, &scene.sun);
        self.upload_things(gpu, scene, &frustum, settings.outline_error_px / focal_px, &casters);
        let tiles: Vec<CasterTile> = casters.iter().map(|caster| caster.tile).collect();
        self.uploaded_bytes += self.tiles.write(gpu, &tiles);
        self.uploaded_bytes += self.caster_grid.write(gpu, &shadow::caster_grid(scene, &casters));
        let uniforms = frame_uniforms(scene, settings, &horizon);
        self.uploaded_bytes += self.frame.write(gpu, &[uniforms]);
        self.upload_horizon(gpu, &horizon);
    }

    /// Triangles drawn in the scene pass.
    #[must_use]
    pub fn drawn_triangles(&self) -> u64 {
        let count = |d: &Draw| u64::from(d.indices.end - d.indices.start) / 3 * d.instances.len() as u64;
        self.draws.surfaces.iter().chain(&self.draws.sky).map(count).sum()
    }

    /// The index buffer depends on the number of the ground's cells alone.
    fn upload_indices(&mut self, gpu: &Gpu, scene: &Scene) {
        let cells = scene.terrain.cells;
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
        let spans =
            || (0..cells).step_by(BLOCK_CELLS as usize).map(|first| first..(first + BLOCK_CELLS).min(cells));
        let blocks = spans()
            .flat_map(|rows| spans().map(move |columns| (columns, rows.clone())))
            .map(|(columns, rows)| {
                let indices = range(&mut scene.terrain.block_triangles(columns.clone(), rows.clone()));
                (indices, [columns, rows])
            })
            .collect();
        self.ground = Some(GroundBlocks { cells, blocks });
        self.uploaded_bytes += self.indices.write(gpu, triangles.as_flattened());
    }

    /// Vertices, instances and draws of ground, rocks and sky; `outline_error` is the tangent of the angle by which
    /// an outline may be off.
    fn upload_things(
        &mut self,
        gpu: &Gpu,
        scene: &Scene,
        frustum: &Frustum,
        outline_error: f32,
        casters: &[Caster],
    ) {
        let mut draws = DrawList::default();
        let sphere: Vec<Vertex> = Icosphere::shared().directions[..Icosphere::vertex_count(DOME_LEVEL)]
            .iter()
            .map(|&d| Vertex { position: d, normal: d })
            .collect();
        let ground_base = sphere.len();
        let mut rock_base = ground_base + scene.terrain.vertices.len();
        // Ground.
        let mut instances = vec![Instance {
            scale: 1.0,
            colour: scene.regolith.albedo,
            roughness: scene.regolith.roughness,
            class_id: ClassId::REGOLITH.0.into(),
            ..Default::default()
        }];
        let mut surfaces: Vec<(f32, Draw)> = self
            .ground
            .iter()
            .flat_map(|ground| &ground.blocks)
            .filter_map(|(indices, [columns, rows])| {
                let (low, high) = block_bounds(scene, columns, rows);
                frustum.may_see_box(low, high).then(|| {
                    let nearest = scene.camera.eye.clamp(low, high).distance(scene.camera.eye);
                    let draw =
                        Draw { indices: indices.clone(), base_vertex: ground_base as i32, instances: 0..1 };
                    (nearest, draw)
                })
            })
            .collect();
        // Rocks: an instance each if seen or casting; as many vertices as the finer of the two uses needs.
        let mut uploads: Vec<(usize, &[Vertex])> = Vec::new();
        let mut next_caster = casters.iter().enumerate().peekable();
        for (index, rock) in scene.rocks.iter().enumerate() {
            let tile = next_caster.next_if(|(_, caster)| caster.rock == index);
            let seen = frustum.may_see_ball(rock.centre, rock.radius_m);
            if tile.is_none() && !seen {
                continue;
            }
            let instance = instances.len() as u32;
            let coarsest = |allowed_m: f32| {
                rock.level_errors_m.iter().position(|&error_m| error_m <= allowed_m).unwrap_or(rock.level)
            };
            let draw = |level: usize| Draw {
                indices: self.sphere_levels[level].clone(),
                base_vertex: rock_base as i32,
                instances: instance..instance + 1,
            };
            let mut finest = 0;
            if let Some((_, caster)) = tile {
                let texel_m = 2.0 * caster.tile.half_extent_m / caster.tile.size_px;
                let level = coarsest(CASTER_ERROR_PX * texel_m);
                draws.casters.push(draw(level));
                finest = level;
            }
            if seen {
                let nearest_m = (rock.centre.distance(scene.camera.eye) - rock.radius_m).max(0.0);
                let level = coarsest(outline_error * nearest_m);
                surfaces.push((nearest_m, draw(level)));
                finest = finest.max(level);
            }
            instances.push(Instance {
                origin: rock.centre,
                scale: 1.0,
                colour: rock.material.albedo,
                roughness: rock.material.roughness,
                class_id: ClassId::ROCK.0.into(),
                instance_id: rock.index + 1,
                tile: tile.map_or(0, |(i, _)| i as u32),
                reserved: 0,
            });
            let vertices = &rock.vertices[..Icosphere::vertex_count(finest)];
            uploads.push((rock_base, vertices));
            rock_base += vertices.len();
        }
        surfaces.sort_by(|a, b| a.0.total_cmp(&b.0));
        draws.surfaces = surfaces.into_iter().map(|(_, draw)| draw).collect();
        // Sky: stars before the dome that they cover.
        let in_sky = |origin, scale, colour| Instance {
            origin,
            scale,
            colour,
            class_id: ClassId::SKY.0.into(),
            ..Default::default()
        };
        let first_star = instances.len() as u32;
        instances.extend(
            scene
                .sky
                .stars
                .iter()
                .filter(|star| frustum.may_see_ball(star.centre, star.radius_m))
                .map(|star| in_sky(star.centre, star.radius_m, STAR_RADIANCE)),
        );
        let dome = instances.len() as u32;
        instances.push(in_sky(scene.sky.centre, scene.sky.radius_m, DOME_RADIANCE));
        for (level, range) in [(STAR_LEVEL, first_star..dome), (DOME_LEVEL, dome..dome + 1)] {
            draws.sky.push(Draw {
                indices: self.sphere_levels[level].clone(),
                base_vertex: 0,
                instances: range,
            });
        }
        self.draws = draws;
        let stride = size_of::<Vertex>();
        self.vertices.reserve(gpu, rock_base * stride);
        uploads.extend([(0, &sphere[..]), (ground_base, &scene.terrain.vertices[..])]);
        for (base, vertices) in uploads {
            self.uploaded_bytes += self.vertices.write_at(gpu, base * stride, vertices);
        }
        self.uploaded_bytes += self.instances.write(gpu, &instances);
    }

    fn upload_horizon(&mut self, gpu: &Gpu, map: &HorizonMap) {
        let [width, height] = map.size;
        let fits = |texture: &wgpu::Texture| texture.width() >= width && texture.height() >= height;
        if !self.horizon.as_ref().is_some_and(|(texture, _)| fits(texture)) {
            let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
            self.horizon = Some(gpu.texture("shadow/horizon", map.size, TextureFormat::Rg32Float, usage));
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

/// Lowest and highest corner of the box around a block of the ground.
fn block_bounds(scene: &Scene, columns: &Range<u32>, rows: &Range<u32>) -> (Vec3, Vec3) {
    let row_len = scene.terrain.cells as usize + 1;
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for row in rows.start..=rows.end {
        let first = row as usize * row_len;
        for vertex in &scene.terrain.vertices[first + columns.start as usize..=first + columns.end as usize] {
            low = low.min(vertex.position);
            high = high.max(vertex.position);
        }
    }
    (low, high)
}

fn frame_uniforms(scene: &Scene, settings: &RenderSettings, horizon: &HorizonMap) -> FrameUniforms {
    let (camera, sun) = (&scene.camera, &scene.sun);
    let sun_right =
        if sun.direction.z.abs() > 0.999 { Vec3::X } else { Vec3::Z.cross(sun.direction).normalize() };
    let sun_right = (sun_right - sun.direction * sun_right.dot(sun.direction)).normalize();
    let clip_from_offset = camera.clip_from_world(settings.size) * Mat4::from_translation(camera.eye);
    FrameUniforms {
        clip_from_offset,
        eye: camera.eye,
        exposure: resolve::exposure(camera.exposure_ev),
        sun_direction: sun.direction,
        sun_tan_half_angle: sun.tan_half_angle(),
        sun_irradiance: sun.irradiance,
        atlas_layer_px: shadow::atlas_px() as f32,
        sun_right,
        atlas_width_px: shadow::atlas_px() as f32,
        sun_up: sun.direction.cross(sun_right),
        horizon_step_m: horizon.step_m,
        ground_radiance: scene.regolith.albedo * sun.irradiance * sun.direction.z / std::f32::consts::PI,
        caster_cell_m: scene.terrain.size_m / shadow::CASTER_CELLS as f32,
        sky_radiance: DOME_RADIANCE,
        caster_cells: shadow::CASTER_CELLS,
        horizon_origin: horizon.origin,
        horizon_towards: horizon.towards,
        horizon_size: horizon.size,
        caster_origin: glam::Vec2::splat(-0.5 * scene.terrain.size_m),
        picture_size_px: settings.size,
        samples_per_side: settings.samples_per_side,
        reserved: 0,
    }
}

/// The six planes that bound what the camera sees. Tests may say yes for a thing just outside, never no for one
/// inside.
#[derive(Clone, Copy, Debug)]
pub struct Frustum {
    /// Normals inward, unit; distance in w.
    planes: [Vec4; 5],
}

impl Frustum {
    /// The frustum of a reversed-depth projection, without its far plane (the sky's dome lies before it).
    #[must_use]
    pub fn new(clip_from_world: &Mat4) -> Self {
        let row = |i| clip_from_world.row(i);
        let planes = [row(3) + row(0), row(3) - row(0), row(3) + row(1), row(3) - row(1), row(3) - row(2)];
        Self { planes: planes.map(|plane| plane / plane.truncate().length()) }
    }

    fn may_see(&self, furthest_inside: impl Fn(Vec4) -> f32) -> bool {
        self.planes.iter().all(|&plane| furthest_inside(plane) >= 0.0)
    }

    /// Whether a ball may be seen.
    #[must_use]
    pub fn may_see_ball(&self, centre: Vec3, radius_m: f32) -> bool {
        self.may_see_swept_ball(centre, centre, radius_m)
    }

    /// Whether a ball that moves from `start` to `end` may be seen anywhere on its way.
    #[must_use]
    pub fn may_see_swept_ball(&self, start: Vec3, end: Vec3, radius_m: f32) -> bool {
        self.may_see(|plane| plane.dot(start.extend(1.0)).max(plane.dot(end.extend(1.0))) + radius_m)
    }

    /// Whether a box may be seen.
    #[must_use]
    pub fn may_see_box(&self, low: Vec3, high: Vec3) -> bool {
        self.may_see(|plane| {
            let corner = Vec3::select(plane.truncate().cmpge(Vec3::ZERO), high, low);
            plane.dot(corner.extend(1.0))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Camera;

    #[test]
    fn frustum_sees_what_is_before_the_lens_and_nothing_behind_it() {
        let camera = Camera::new(Vec3::new(0.0, -90.0, 2.0), [0.0, 0.0, 0.0], 60.0, 2000.0, 0.0);
        let frustum = Frustum::new(&camera.clip_from_world([64, 64]));
        let at = |x: f32, y: f32| Vec3::new(x, y, 2.0);
        assert!(frustum.may_see_ball(at(0.0, 0.0), 0.1));
        assert!(!frustum.may_see_ball(at(0.0, -100.0), 1.0));
        assert!(!frustum.may_see_ball(at(80.0, -50.0), 1.0));
        assert!(frustum.may_see_ball(at(24.0, -50.0), 2.0), "just outside, but its side is in view");
        assert!(frustum.may_see_swept_ball(at(80.0, -50.0), at(0.0, -50.0), 1.0));
        assert!(frustum.may_see_box(at(-1.0, -80.0), at(1.0, -70.0)));
        assert!(!frustum.may_see_box(at(-1.0, -130.0), at(1.0, -110.0)));
    }
}
