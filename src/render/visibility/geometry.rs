//! The triangles that may be seen, as they lie on the samples of a picture: what [`crate::render::visibility::host`] draws.
//!
//! A driver that runs on the CPU runs every branch of a shader: ground on which no shadow can fall, or only that of other
//! ground, and rock that is turned from the sun are told apart, to be lit by a program without the rest.
//! Must not know: buffers.

use std::ops::Range;

use fearless_simd::{Level, dispatch};
use glam::{BVec2, Mat4, UVec2, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use crate::render::device::shading_bins::{ShadingBin, ShadingBins, ShadowSources};
use crate::render::lighting::relief_bands::Bands;
use crate::render::lighting::slopes_host::Slopes;
use crate::render::raster::{
    self, AT_ONCE, FURTHEST_PX, Outline, Place, Plane, Sides, Sifted, Span, Turn, VERTICES, by_axis,
    texels_between,
};
use crate::render::select::caster_grid::CasterGrids;
use crate::render::select::ground_blocks::{BLOCK_CELLS, ground_blocks};
use crate::render::select::screen_bounds::ScreenBounds;
use crate::render::select::selection::{SelectedRock, Selection, Slots, front_to_back};
use crate::render::settings::RenderSettings;
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::noise::floor;
use crate::scene::rocks::Rock;
use crate::scene::sky::{DOME_LEVEL, STAR_LEVEL};

/// Normals are turned from the sun if the sine of their angle to its terminator is above this: a device's arithmetic may
/// differ from ours.
const DARK: f32 = 1e-4;

/// A vertex on the picture.
#[derive(Clone, Copy, Debug, Default)]
pub struct Corner {
    /// Among the samples.
    pub place: Place,
    /// The same before it is rounded, samples from the middle of the first.
    pub at: Vec2,
    /// One over the metres along the axis; 0 of one that has no place: not before the lens, or far beside the picture.
    pub inverse_w: f32,
    /// Its normal times that: linear over the picture.
    pub normal_per_w: Vec3,
}

impl Corner {
    /// What is linear over the picture: one over the metres along the axis, and the normal times that.
    #[must_use]
    #[inline(always)]
    pub fn values(&self) -> [f32; 4] {
        let [x, y, z] = self.normal_per_w.to_array();
        [self.inverse_w, x, y, z]
    }
}

/// A triangle that may cover samples. Its corners run counter-clockwise as it is seen.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    /// By their places in [`Mesh::corners`].
    pub corners: [u32; 3],
    /// Its own normal, towards the eye, packed as `visibility.wgsl` does; 0 where no rock can shade it, for nothing asks for it.
    pub facing: u32,
    /// First and last row of samples that it may cover.
    pub rows: [u16; 2],
    /// What can shade it.
    pub shades: ShadowSources,
    /// Of a piece of a triangle that was clipped, its place in [`Mesh::clipped`]: the piece may be thin and its corners far away.
    pub clipped: Option<u32>,
}

/// For each of [`ShadowSources`].
const SHADES: usize = ShadowSources::ALL.len();

/// A mesh on the picture.
#[derive(Debug, Default)]
pub struct Mesh {
    /// Slot of its instance.
    pub slot: u32,
    /// The groups of its facets, by what can shade them.
    pub groups: [ShadingBin; SHADES],
    /// Where these may be.
    pub bounds: [ScreenBounds; SHADES],
    /// Its vertices, and what clipping added.
    pub corners: Vec<Corner>,
    /// Whether all of its vertices have places.
    is_placed: bool,
    /// Its triangles.
    pub facets: Vec<Facet>,
    /// Of triangles that were clipped: one over the metres along the axis, and the normal times that, from the first sample on.
    pub clipped: Vec<[Plane; 4]>,
    /// First and last row of samples that it may cover.
    pub rows: [u16; 2],
}

/// What a mesh is of.
#[derive(Clone, Copy, Debug)]
enum Source {
    Rock(usize),
    Block(usize),
    Stars,
    Dome,
}

/// Most meshes that a thread takes at a time: they take very different times.
const AT_A_TIME: usize = 4;

/// How many of these are of the sky; they are the last.
const SKY_MESHES: usize = 2;

/// The meshes of a picture, in the order in which they are drawn; kept for their memory.
#[derive(Debug, Default)]
pub struct Facets {
    meshes: Vec<Mesh>,
    used: usize,
    groups: ShadingBins,
    /// Of ground that has a relief below its mesh.
    slopes: Option<Slopes>,
}

impl Facets {
    /// Where the slopes of the ground below its mesh come from, if there are any.
    #[must_use]
    pub const fn slopes(&self) -> Option<&Slopes> {
        self.slopes.as_ref()
    }

    /// Finds those of a selection. `caster_grid` is that of [`crate::render::select::casters::caster_grid`]. Unless `by_shades`, all is lit as if
    /// it could be shaded by anything.
    pub fn find(
        &mut self,
        scene: &Scene,
        selection: &Selection,
        settings: &RenderSettings,
        caster_grid: &[u32],
        bands: &Bands,
        by_shades: bool,
    ) {
        let groups = ShadingBins::new(bands.bands.len());
        self.groups = groups;
        let rays = settings.rays(&scene.camera);
        self.slopes = scene.relief.as_ref().map(|_| Slopes::new(bands, groups, rays));
        let of = Picture {
            scene,
            samples: Samples::new(&scene.camera, settings),
            sun: if by_shades { scene.sun.direction } else { Vec3::ZERO },
            grids: by_shades.then(|| CasterGrids::new(&scene.terrain)),
            caster_grid,
        };
        let seen = selection.rocks.iter().enumerate().filter(|(_, rock)| rock.visible_level.is_some());
        let rocks = front_to_back(seen.map(|(place, rock)| (rock.nearest_m, place)));
        let blocks = selection.blocks.iter().enumerate();
        let blocks = front_to_back(blocks.map(|(place, &(_, nearest_m))| (nearest_m, place)));
        let sources: Vec<Source> = (rocks.iter().map(|&(_, place)| Source::Rock(place)))
            .chain(blocks.iter().map(|&(_, place)| Source::Block(place)))
            .chain([Source::Stars, Source::Dome])
            .collect();
        self.used = sources.len();
        if self.meshes.len() < self.used {
            self.meshes.resize_with(self.used, Mesh::default);
        }
        let spans: Vec<[Range<u32>; 2]> = ground_blocks(&scene.terrain).collect();
        let meshes = self.meshes.par_iter_mut().zip(sources).with_max_len(AT_A_TIME);
        meshes.for_each(|(mesh, source)| match source {
            Source::Rock(place) => {
                let groups = ShadowSources::ALL.map(ShadingBins::rocks);
                mesh.restart(Slots::rock(place), groups);
                mesh.add_rock(&of, &selection.rocks[place]);
            }
            Source::Block(place) => {
                let (block, _) = selection.blocks[place];
                let band = bands.of_block(block);
                mesh.restart(
                    Slots::GROUND,
                    ShadowSources::ALL.map(|shades| ShadingBins::ground(band, shades)),
                );
                mesh.add_block(&of, &spans[block]);
            }
            Source::Stars => {
                mesh.restart(0, [groups.stars(); SHADES]);
                for &star in &selection.stars {
                    let star = &scene.sky.stars[star];
                    mesh.add_sphere(&of, STAR_LEVEL, star.centre, star.radius_m);
                }
            }
            Source::Dome => {
                mesh.restart(0, [groups.dome(); SHADES]);
                mesh.add_sphere(&of, DOME_LEVEL, scene.sky.centre, scene.sky.radius_m);
            }
        });
    }

    /// The groups that they are of.
    #[must_use]
    pub const fn groups(&self) -> ShadingBins {
        self.groups
    }

    /// Rows of samples that may show anything but the sky.
    #[must_use]
    pub fn rows_of_things(&self) -> Range<u32> {
        let things = &self.meshes()[..self.used.saturating_sub(SKY_MESHES)];
        let first = things.iter().map(|mesh| mesh.rows[0]).min().unwrap_or(u16::MAX);
        let last = things.iter().map(|mesh| mesh.rows[1]).max().unwrap_or(0);
        if first <= last { first.into()..u32::from(last) + 1 } else { 0..0 }
    }

    /// The meshes, near ones before what they may cover.
    #[must_use]
    pub fn meshes(&self) -> &[Mesh] {
        &self.meshes[..self.used]
    }
}

/// Of what the facets are looked for.
struct Picture<'a> {
    scene: &'a Scene,
    samples: Samples,
    /// Towards the sun; zero if nothing is to be told to be turned from it.
    sun: Vec3,
    grids: Option<CasterGrids>,
    caster_grid: &'a [u32],
}

impl Picture<'_> {
    /// What can shade what lies in a box, as seen from above.
    fn shades_over(&self, low: Vec2, high: Vec2) -> ShadowSources {
        self.grids.map_or(ShadowSources::GroundAndRocks, |grids| {
            grids.shadow_sources_over(self.caster_grid, low, high)
        })
    }

    /// What can shade a cell of the ground.
    fn shades_over_cell(&self, column: u32, row: u32) -> ShadowSources {
        let corners = self.scene.terrain.corners(column, row).map(Vec3::truncate);
        let (low, high) =
            corners.iter().fold((corners[0], corners[0]), |(low, high), p| (low.min(*p), high.max(*p)));
        self.shades_over(low, high)
    }
}

/// Where samples lie: as a device reckons it.
#[derive(Clone, Debug)]
struct Samples {
    clip_from_offset: Mat4,
    half_size: Vec2,
    /// The same, parts of a sample.
    half_parts: [i32; 2],
    width: usize,
    rows: Range<i32>,
    near_m: f32,
    /// How far beside the lens's axis a place may be, of what is as far as the picture's border: nothing is drawn beyond.
    reach: Vec2,
}

/// A vertex before it has a place: homogeneous coordinates among the samples.
#[derive(Clone, Copy, Debug)]
struct Homogeneous {
    at: Vec2,
    w: f32,
    normal: Vec3,
    /// Its place among the corners, if it has one.
    corner: Option<u32>,
}

impl Samples {
    fn new(camera: &Camera, settings: &RenderSettings) -> Self {
        let size = settings.sample_size();
        let half_size = 0.5 * UVec2::from(size).as_vec2();
        Self {
            clip_from_offset: camera.clip_from_world(settings.size) * Mat4::from_translation(camera.eye),
            half_size,
            half_parts: size.map(|side| side as i32 * (raster::PARTS / 2)),
            width: size[0] as usize,
            rows: 0..size[1] as i32,
            near_m: camera.near_m,
            reach: FURTHEST_PX / half_size,
        }
    }

    /// Homogeneous coordinates of an offset from the eye, rows running down.
    #[inline]
    fn clip(&self, offset: Vec3) -> (Vec2, f32) {
        let clip = self.clip_from_offset * offset.extend(1.0);
        (Vec2::new(clip.x, -clip.y), clip.w)
    }

    /// Adds the corners of up to [`VERTICES`] vertices of what lies at `origin`, metres from the eye: as [`Self::projected`] has them,
    /// but without a place where one is not before the lens or far beside the picture.
    // Inlined wholly, for each width of vectors; see `scene/noise.rs`.
    #[inline(always)]
    fn place(&self, origin: Vec3, vertices: &[Vertex], corners: &mut Vec<Corner>) {
        let [x_row, y_row, _, w_row] = [0, 1, 2, 3].map(|row| self.clip_from_offset.row(row));
        let ([half_x, half_y], [right, down]) = (self.half_size.to_array(), self.half_parts);
        let [x, y, z] = by_axis(vertices.iter().map(|v| v.position));
        let [normal_x, normal_y, normal_z] = by_axis(vertices.iter().map(|v| v.normal));
        let mut placed = [[0; VERTICES]; 2];
        let mut values = [[0.0; VERTICES]; 6];
        for i in 0..VERTICES {
            let offset = [origin.x + x[i], origin.y + y[i], origin.z + z[i]];
            let (x, y, w) = (clip_axis(x_row, offset), -clip_axis(y_row, offset), clip_axis(w_row, offset));
            let is_placed =
                (w >= self.near_m) & (x.abs() <= self.reach.x * w) & (y.abs() <= self.reach.y * w);
            let inverse_w = 1.0 / w;
            let (x, y) = (x * inverse_w * half_x + half_x, y * inverse_w * half_y + half_y);
            let (column, row) = (Place::part(x - 0.5 - half_x) + right, Place::part(y - 0.5 - half_y) + down);
            placed[0][i] = if is_placed { column } else { 0 };
            placed[1][i] = if is_placed { row } else { 0 };
            values[0][i] = if is_placed { x - 0.5 } else { 0.0 };
            values[1][i] = if is_placed { y - 0.5 } else { 0.0 };
            values[2][i] = if is_placed { inverse_w } else { 0.0 };
            values[3][i] = if is_placed { inverse_w * normal_x[i] } else { 0.0 };
            values[4][i] = if is_placed { inverse_w * normal_y[i] } else { 0.0 };
            values[5][i] = if is_placed { inverse_w * normal_z[i] } else { 0.0 };
        }
        corners.extend((0..vertices.len().min(VERTICES)).map(|i| Corner {
            place: Place { x: placed[0][i], y: placed[1][i] },
            at: Vec2::new(values[0][i], values[1][i]),
            inverse_w: values[2][i],
            normal_per_w: Vec3::new(values[3][i], values[4][i], values[5][i]),
        }));
    }

    /// Of what is before the lens and not far beside the picture, rows running down.
    #[inline]
    fn projected(&self, at: Vec2, w: f32, normal: Vec3) -> Corner {
        let inverse_w = 1.0 / w;
        let at = at * inverse_w * self.half_size + self.half_size;
        // Counted from near the middle, so that all that is in reach can be rounded.
        let Place { x, y } = Place::rounded(at - 0.5 - self.half_size);
        let [right, down] = self.half_parts;
        let place = Place { x: x + right, y: y + down };
        Corner { place, at: at - 0.5, inverse_w, normal_per_w: inverse_w * normal }
    }

    /// What is linear over the picture of a triangle, wherever its corners are: one over the metres along the axis, and the normal
    /// times that (Olano and Greer 1997, "Triangle Scan Conversion using 2D Homogeneous Coordinates", section 3). None of a
    /// triangle that is seen edge-on.
    fn planes(&self, triangle: [Homogeneous; 3]) -> Option<[Plane; 4]> {
        let half = self.half_size.as_dvec2();
        let [a, b, c] = triangle.map(|v| {
            let (at, w) = (v.at.as_dvec2(), f64::from(v.w));
            (at * half + w * (half - 0.5)).extend(w)
        });
        let (of_a, of_b, of_c) = (b.cross(c), c.cross(a), a.cross(b));
        let volume = a.dot(of_a);
        let plane = |values: [f32; 3]| {
            let [at_a, at_b, at_c] = values.map(f64::from);
            let [per_column, per_row, first] =
                ((at_a * of_a + at_b * of_b + at_c * of_c) / volume).as_vec3().to_array();
            Plane { first, per_column, per_row }
        };
        let normals = triangle.map(|v| v.normal);
        let axes = [|n: Vec3| n.x, |n: Vec3| n.y, |n: Vec3| n.z];
        let [x, y, z] = axes.map(|axis| plane(normals.map(axis)));
        (volume != 0.0).then_some([plane([1.0; 3]), x, y, z])
    }

    /// What of a triangle is before the lens and not far beside the picture: a convex polygon, or nothing.
    fn clipped(&self, triangle: [Homogeneous; 3]) -> Vec<Homogeneous> {
        let reach = self.reach;
        let inside: [&dyn Fn(&Homogeneous) -> f32; 5] = [
            &|v| v.w - self.near_m,
            &|v| reach.x * v.w - v.at.x,
            &|v| reach.x * v.w + v.at.x,
            &|v| reach.y * v.w - v.at.y,
            &|v| reach.y * v.w + v.at.y,
        ];
        let between = |stays: &Homogeneous, goes: &Homogeneous, t: f32| Homogeneous {
            at: stays.at + t * (goes.at - stays.at),
            w: stays.w + t * (goes.w - stays.w),
            normal: stays.normal + t * (goes.normal - stays.normal),
            corner: None,
        };
        inside.iter().fold(triangle.to_vec(), |polygon, distance| raster::cut(&polygon, distance, between))
    }
}

// A row of a block of ground has two triangles a cell.
const _: () = assert!(AT_ONCE >= 2 * BLOCK_CELLS as usize);

impl Mesh {
    /// The corners of one of its facets.
    #[must_use]
    #[inline(always)]
    pub fn corners_of(&self, facet: &Facet) -> [Corner; 3] {
        facet.corners.map(|corner| self.corners[corner as usize])
    }

    /// One over the metres along the axis, and the normal times that, over the outline of a facet with these corners.
    #[must_use]
    #[inline(always)]
    pub fn planes(&self, facet: &Facet, corners: [Corner; 3], outline: &Outline) -> [Plane; 4] {
        facet.clipped.map_or_else(
            || outline.planes(corners.map(|corner| corner.at), corners.map(|corner| corner.values())),
            |clipped| self.clipped[clipped as usize].map(|plane| outline.from_here(plane)),
        )
    }

    fn restart(&mut self, slot: u32, groups: [ShadingBin; SHADES]) {
        (self.slot, self.groups) = (slot, groups);
        self.bounds = [ScreenBounds::EMPTY; SHADES];
        self.rows = [u16::MAX, 0];
        self.is_placed = true;
        self.corners.clear();
        self.facets.clear();
        self.clipped.clear();
    }

    /// Adds the vertices of what lies at `origin`, metres from the eye.
    fn extend(&mut self, samples: &Samples, origin: Vec3, vertices: &[Vertex]) {
        self.corners.reserve(vertices.len());
        for vertices in vertices.chunks(VERTICES) {
            let first = self.corners.len();
            dispatch!(Level::new(), _simd => samples.place(origin, vertices, &mut self.corners));
            self.is_placed &= self.corners[first..].iter().all(|corner| corner.inverse_w > 0.0);
        }
    }

    fn add_rock(&mut self, of: &Picture<'_>, selected: &SelectedRock) {
        let Some(level) = selected.visible_level else { return };
        let rock = &of.scene.rocks[selected.rock];
        let origin = rock.centre - of.scene.camera.eye;
        // Whatever lies below the lowest ground around the rock is under the ground.
        let buried_m = lowest_ground_m(of.scene, rock) - rock.centre.z;
        let vertices = &rock.vertices[..Icosphere::vertex_count(level.min(rock.level))];
        let (middle, reach) = (rock.centre.truncate(), Vec2::splat(rock.radius_m));
        let lit_shades = of.shades_over(middle - reach, middle + reach);
        self.extend(&of.samples, origin, vertices);
        let vertex = |v: u32| (origin + vertices[v as usize].position, vertices[v as usize].normal);
        for triangles in rock.triangles(level).chunks(AT_ONCE) {
            for &number in self.sifted(&of.samples, triangles).numbers() {
                let triangle = triangles[usize::from(number)];
                let corners = triangle.map(|vertex| &vertices[vertex as usize]);
                let shades = || {
                    let [a, b, c] = corners.map(|corner| corner.position.z);
                    let dark = corners.iter().all(|corner| corner.normal.dot(of.sun) < -DARK);
                    let shades = if dark { ShadowSources::None } else { lit_shades };
                    (a.max(b).max(c) > buried_m).then_some(shades)
                };
                self.add(&of.samples, triangle, Sides::Outside, shades, vertex);
            }
        }
    }

    /// Of a block of ground.
    fn add_block(&mut self, of: &Picture<'_>, [columns, rows]: &[Range<u32>; 2]) {
        let (terrain, eye) = (&of.scene.terrain, of.scene.camera.eye);
        // Vertices by their place in the block.
        let (row_len, block_row_len) = (terrain.columns + 1, columns.len() as u32 + 1);
        for row in rows.start..=rows.end {
            let first = (row * row_len + columns.start) as usize;
            self.extend(&of.samples, -eye, &terrain.vertices[first..first + block_row_len as usize]);
        }
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        for row in rows.clone() {
            let (south, first) = (row * row_len + columns.start, (row - rows.start) * block_row_len);
            let in_block = |vertex: u32| {
                let skipped = if vertex >= south + row_len { row_len - block_row_len } else { 0 };
                first + (vertex - south - skipped)
            };
            let vertex = |place: u32| {
                let skipped = if place >= first + block_row_len { row_len - block_row_len } else { 0 };
                let vertex = &terrain.vertices[(south + (place - first) + skipped) as usize];
                (vertex.position - eye, vertex.normal)
            };
            triangles.clear();
            triangles.extend(
                terrain
                    .block_triangles(columns.clone(), row..row + 1)
                    .map(|[a, b, c]| [in_block(a), in_block(b), in_block(c)]),
            );
            let per_cell = triangles.len() / columns.len();
            let mut of_cell = None;
            for &number in self.sifted(&of.samples, &triangles).numbers() {
                let column = columns.start + (usize::from(number) / per_cell) as u32;
                let shades = || match of_cell {
                    Some((known, shades)) if known == column => Some(shades),
                    _ => {
                        let shades = of.shades_over_cell(column, row);
                        of_cell = Some((column, shades));
                        Some(shades)
                    }
                };
                self.add(&of.samples, triangles[usize::from(number)], Sides::Outside, shades, vertex);
            }
        }
    }

    /// Of the sky, which is seen from inside too.
    fn add_sphere(&mut self, of: &Picture<'_>, level: usize, centre: Vec3, radius_m: f32) {
        let sphere = Icosphere::shared();
        let first = self.corners.len() as u32;
        let origin = centre - of.scene.camera.eye;
        let directions = &sphere.directions[..Icosphere::vertex_count(level)];
        let vertices: Vec<Vertex> =
            directions.iter().map(|&d| Vertex { position: radius_m * d, normal: d }).collect();
        self.extend(&of.samples, origin, &vertices);
        for triangle in &sphere.triangles[level] {
            let triangle = triangle.map(|vertex| first + vertex);
            let vertex = |place: u32| {
                let Vertex { position, normal } = vertices[(place - first) as usize];
                (origin + position, normal)
            };
            self.add(&of.samples, triangle, Sides::Both, || Some(ShadowSources::None), vertex);
        }
    }

    /// Which of some triangles of what is seen from outside may be seen.
    fn sifted(&self, samples: &Samples, triangles: &[[u32; 3]]) -> Sifted {
        if !self.is_placed {
            return Sifted::all(triangles.len());
        }
        let place_of = |corner: u32| self.corners[corner as usize].place;
        dispatch!(Level::new(), simd => {
            Sifted::new(simd, triangles, place_of, Sides::Outside, samples.width, &samples.rows)
        })
    }

    /// Adds what may be seen of a triangle. `shades` tells what can shade it, unless something hides it; `vertex` the offset of
    /// a corner from the eye, and its normal.
    #[inline]
    fn add(
        &mut self,
        samples: &Samples,
        triangle: [u32; 3],
        sides: Sides,
        shades: impl FnOnce() -> Option<ShadowSources>,
        vertex: impl Fn(u32) -> (Vec3, Vec3),
    ) {
        let is_placed = |corner: u32| self.corners[corner as usize].inverse_w > 0.0;
        if triangle.iter().all(|&corner| is_placed(corner)) {
            let Some((triangle, texels)) = self.shown(samples, triangle, sides) else { return };
            if let Some(shades) = shades() {
                let facing = || facing(triangle.map(&vertex));
                self.push(triangle, texels, shades, facing, None);
            }
            return;
        }
        let homogeneous = triangle.map(|corner| {
            let (offset, normal) = vertex(corner);
            let (at, w) = samples.clip(offset);
            Homogeneous { at, w, normal, corner: is_placed(corner).then_some(corner) }
        });
        // Wholly behind the lens or beside the picture.
        let beside: [fn(&Homogeneous) -> f32; 4] =
            [|v| v.w - v.at.x, |v| v.w + v.at.x, |v| v.w - v.at.y, |v| v.w + v.at.y];
        if homogeneous.iter().all(|v| v.w < samples.near_m)
            || beside.iter().any(|inside| homogeneous.iter().all(|v| inside(v) < 0.0))
        {
            return;
        }
        let polygon: Vec<u32> = samples
            .clipped(homogeneous)
            .into_iter()
            .map(|v| {
                v.corner.unwrap_or_else(|| {
                    self.corners.push(samples.projected(v.at, v.w, v.normal));
                    self.corners.len() as u32 - 1
                })
            })
            .collect();
        let shown: Vec<_> = (2..polygon.len())
            .filter_map(|i| self.shown(samples, [polygon[0], polygon[i - 1], polygon[i]], sides))
            .collect();
        if shown.is_empty() {
            return;
        }
        if let (Some(planes), Some(shades)) = (samples.planes(homogeneous), shades()) {
            let clipped = Some(self.clipped.len() as u32);
            self.clipped.push(planes);
            for (corners, texels) in shown {
                self.push(corners, texels, shades, || facing(triangle.map(&vertex)), clipped);
            }
        }
    }

    /// A triangle, as it is seen counter-clockwise, and the columns and rows of samples around it; none if it covers no sample.
    #[inline]
    fn shown(&self, samples: &Samples, [a, b, c]: [u32; 3], sides: Sides) -> Option<([u32; 3], Span)> {
        let places = [a, b, c].map(|corner| self.corners[corner as usize].place);
        let texels = texels_between(places, samples.width, &samples.rows)?;
        match (Turn::of(places)?, sides) {
            (Turn::Front, _) => Some(([a, b, c], texels)),
            (Turn::Back, Sides::Both) => Some(([a, c, b], texels)),
            (Turn::Back, Sides::Outside) => None,
        }
    }

    #[inline]
    fn push(
        &mut self,
        corners: [u32; 3],
        [columns, rows]: Span,
        shades: ShadowSources,
        facing: impl FnOnce() -> u32,
        clipped: Option<u32>,
    ) {
        let bounds = &mut self.bounds[shades as usize];
        *bounds = bounds.union(ScreenBounds::of_samples(columns, rows));
        let facing = if shades.has_rocks() { facing() } else { 0 };
        let rows = [rows.0 as u16, rows.1 as u16];
        self.rows = [self.rows[0].min(rows[0]), self.rows[1].max(rows[1])];
        self.facets.push(Facet { corners, facing, rows, shades, clipped });
    }
}

/// A row of a matrix times an offset, in the order of the product with the whole.
#[inline(always)]
fn clip_axis(row: Vec4, [x, y, z]: [f32; 3]) -> f32 {
    row.x * x + row.y * y + row.z * z + row.w
}

/// A height that the ground around a rock does not fall below.
fn lowest_ground_m(scene: &Scene, rock: &Rock) -> f32 {
    let terrain = &scene.terrain;
    let (centre, radius) = (rock.centre.truncate(), Vec2::splat(rock.radius_m));
    let (low, high) = (centre - radius, centre + radius);
    let corners = [low, high, Vec2::new(low.x, high.y), Vec2::new(high.x, low.y)];
    if !corners.iter().all(|corner| terrain.contains(*corner)) {
        // Beyond its border there is no ground to be under.
        return f32::NEG_INFINITY;
    }
    terrain.lowest_over(low, high)
}

/// The normal of a triangle towards the eye, packed; of its corners' offsets from the eye.
#[inline]
fn facing([a, b, c]: [(Vec3, Vec3); 3]) -> u32 {
    let normal = (b.0 - a.0).cross(c.0 - a.0);
    let towards = if normal.dot(a.0) < 0.0 { normal } else { -normal };
    // `pack2x16snorm` of WGSL.
    let half = |x: f32| floor(0.5 + 32_767.0 * x.clamp(-1.0, 1.0)) as u32 & 0xffff;
    let [x, y] = octahedron(towards).into();
    half(x) | (half(y) << 16)
}

/// A direction as two numbers. Twin: `octahedral_encode` in `common/octahedral.wgsl`.
#[inline]
fn octahedron(v: Vec3) -> Vec2 {
    let p = v.truncate() / v.abs().element_sum().max(1e-30);
    let folded = 1.0 - Vec2::new(p.y, p.x).abs();
    let folded = Vec2::select(p.cmpge(Vec2::ZERO), folded, -folded);
    Vec2::select(BVec2::splat(v.z >= 0.0), p, folded)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::raster::{Counted, WIDTH};
    use fearless_simd::{Level, dispatch};

    const SIZE: [usize; 2] = [96, 64];

    fn samples(pitch_deg: f64) -> Samples {
        let camera = Camera::new(Vec3::ZERO, [pitch_deg, 0.0, 0.0], 80.0, 2000.0, 0.0);
        let settings = RenderSettings::new(SIZE.map(|side| side as u32), 1).expect("settings");
        Samples::new(&camera, &settings)
    }

    /// A mesh of these triangles.
    fn mesh(samples: &Samples, vertices: &[Vec3], triangles: &[[u32; 3]]) -> Mesh {
        let mut mesh = Mesh::default();
        let as_vertices: Vec<Vertex> =
            vertices.iter().map(|&position| Vertex { position, normal: Vec3::Z }).collect();
        mesh.extend(samples, Vec3::ZERO, &as_vertices);
        for &triangle in triangles {
            let vertex = |v: u32| (vertices[v as usize], Vec3::Z);
            mesh.add(samples, triangle, Sides::Both, || Some(ShadowSources::None), vertex);
        }
        mesh
    }

    /// Ground a metre below the eye that reaches behind it and far beside the picture: every sample below the horizon shows it
    /// once, as far away as the ray meets it.
    #[test]
    fn what_reaches_behind_the_lens_is_cut_without_a_seam() {
        let far_m = 1.0e5;
        let corner = |x: f32, y: f32| Vec3::new(x * far_m, y * far_m, -1.0);
        let vertices =
            [corner(-1.0, -1.3), corner(1.1, -1.0), corner(1.0, 1.2), corner(-0.9, 1.0), Vec3::NEG_Z];
        let triangles = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]];
        let stride = SIZE[0] + WIDTH;
        for pitch_deg in [-70.0, -20.0, 0.0] {
            let samples = samples(pitch_deg);
            let mesh = mesh(&samples, &vertices, &triangles);
            assert!(!mesh.clipped.is_empty());
            let mut count = Counted::new(SIZE);
            for facet in &mesh.facets {
                let corners = mesh.corners_of(facet);
                let places = corners.map(|corner| corner.place);
                let outline = Outline::new(places, SIZE[0], &samples.rows).expect("it covers a sample");
                [count.value, ..] = mesh.planes(facet, corners, &outline);
                let count = &mut count;
                dispatch!(Level::new(), simd => outline.fill(simd, 0, stride, count));
            }
            let place_of = samples.clip_from_offset.as_dmat4().inverse();
            let mut shown = 0;
            for row in 0..SIZE[1] {
                for column in 0..SIZE[0] {
                    let at = glam::DVec2::new(column as f64 + 0.5, row as f64 + 0.5)
                        / samples.half_size.as_dvec2();
                    let near = place_of * glam::DVec4::new(at.x - 1.0, 1.0 - at.y, 1.0, 1.0);
                    let ray = near.truncate() / near.w;
                    // Metres along the axis of the place on the ray that lies a metre down.
                    let expected = -ray.z / f64::from(samples.near_m);
                    let texel = row * stride + column;
                    if expected > 1e-3 {
                        assert_eq!(count.times[texel], 1, "pitch {pitch_deg}, sample {column}, {row}");
                        let found = f64::from(count.values[texel]);
                        assert!((found / expected - 1.0).abs() < 1e-5, "{found} for {expected}");
                        shown += 1;
                    } else if expected < 0.0 {
                        assert_eq!(count.times[texel], 0, "pitch {pitch_deg}, sample {column}, {row}");
                    }
                }
            }
            assert!(shown > 2000, "{shown}");
        }
    }
}
