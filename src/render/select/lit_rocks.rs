//! Sunlit faces of rocks as sources of light: what lights shadows near by (`common/lit_rocks.wgsl`).
//!
//! The triangles of a rock's coarse mesh that the sun reaches, past the ground and the other rocks, are joined to a few faces. Which
//! they are decides most (docs/realism.md): without the shadows of rocks on one another soil in shadow would have up to four times too
//! much light of rocks. A face lights what is within some of its sizes. Grids like those of the casters, with fewer cells, list the faces
//! that reach each cell. Rocks too small to be more than specks in the image are no sources of their own, and those that are light no
//! further; beyond that all rocks light as part of the ground (`rock_cover.rs`).
//! Must not know: how shadows are found.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::render::select::caster_grid::CasterGrids;
use crate::render::select::selection::{SelectedRock, Selection, Slots};
use crate::render::select::sunlight::{COARSE_LEVEL, LimbsAt, Sunlight};
use crate::scene::Scene;
use crate::scene::mesh::Icosphere;
use crate::scene::rocks::Rock;

/// Distance that a face lights, in square roots of its area. `common/lit_rocks.wgsl` has the same.
pub const REACH: f32 = 14.0;
/// Area of the coarse mesh of a sphere over that of the sphere.
const COARSE_AREA: f32 = 0.928;
/// Faces of a rock: to either side of the sun's azimuth. With one, what lies beside it is dark; with six, little changes.
const FACES: usize = 2;
/// Minimum area of a face, as a fraction of the square of its rock's radius.
const MIN_AREA: f32 = 0.003;
/// Cells of the caster grids along a side of a cell of these.
const CASTER_CELLS: u32 = 8;
/// Minimum diameter of a rock that lights anything, pixels or radians as seen from the eye, whichever is less.
const MIN_PX: f32 = 5.0;
/// See [`MIN_PX`].
const MIN_ANGLE: f32 = 0.012;
/// Texels of a face, four numbers each, and faces in a row of the texture of faces. `common/lit_rocks.wgsl` has the same.
pub const FACE_TEXELS: usize = size_of::<LitFace>() / size_of::<[f32; 4]>();
/// See [`FACE_TEXELS`].
pub const FACES_PER_ROW: usize = 64;
/// Texels in a row.
pub const ROW_TEXELS: usize = FACE_TEXELS * FACES_PER_ROW;

/// A sunlit face of a rock, as the shader reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
struct LitFace {
    /// Its middle, metres, world.
    middle: Vec3,
    /// Slot of its rock among the instances, a whole number.
    slot: f32,
    /// Sum of the normals of its sunlit parts times their areas, square metres.
    area_vector: Vec3,
    padding: f32,
    /// Its colour times the irradiance of the sun.
    light: Vec3,
    end_padding: f32,
}

/// The sunlit faces of rocks in a frame, and the cells that each lights.
#[derive(Clone, Debug, Default)]
pub struct LitRocks {
    /// For each cell the start of its list (and after the last cell the end of the last list), then the lists of indices of
    /// faces.
    pub lists: Vec<u32>,
    /// Texels of the faces, and of the light of the ground below them: whole rows of the texture.
    texels: Vec<[f32; 4]>,
    has_faces: bool,
    /// Cells along a side of each grid.
    pub cells: u32,
}

impl LitRocks {
    /// The sunlit rocks among those of a selection. `colour` is the factor from albedo to colour of a rock.
    #[must_use]
    pub fn new(
        scene: &Scene,
        selection: &Selection,
        caster_grid: &[u32],
        limbs: LimbsAt<'_>,
        (colour, pixel_angle): (f32, f32),
    ) -> Self {
        let sunlight = Sunlight::new(scene, &selection.casters, caster_grid, limbs);
        let of_rock = |(index, selected): (usize, &SelectedRock)| {
            let rock = &scene.rocks[selected.rock];
            if is_speck(rock, selected, pixel_angle) || !rock.body.is_rock() {
                return [LitFace::default(); FACES];
            }
            let light = colour * rock.material.albedo * scene.sun.irradiance;
            let faces = faces(scene, &sunlight, selected, &Exposed::new(scene, rock));
            faces.map(|face| LitFace { light, slot: Slots::rock(index) as f32, ..face })
        };
        let faces: Vec<[LitFace; FACES]> = selection.rocks.par_iter().enumerate().map(of_rock).collect();
        let faces = faces.into_iter().flatten().filter(|face| face.area_vector != Vec3::ZERO).collect();
        Self::listed(CasterGrids::new(&scene.terrain), faces)
    }

    /// `FrameUniforms::lit_rocks`, where [`Self::lists`] follow this many other words.
    #[must_use]
    pub fn uniform(&self, before: usize) -> [u32; 4] {
        [before as u32, self.cells, u32::from(self.has_faces), 0]
    }

    /// Columns and rows of the texture of faces: no row if there are none.
    #[must_use]
    pub fn texture_size(&self) -> [u32; 2] {
        [ROW_TEXELS as u32, (self.texels.len() / ROW_TEXELS) as u32]
    }

    /// Texels of the texture of faces, in row-major order.
    #[must_use]
    pub fn texels(&self) -> &[[f32; 4]] {
        &self.texels
    }

    /// Appends whole rows to the texture and returns the first of them.
    pub fn append(&mut self, texels: &[[f32; 4]]) -> u32 {
        let [_, first] = self.texture_size();
        self.texels.extend_from_slice(texels);
        first
    }

    /// Lists the faces by the cells that they reach: a counting sort.
    fn listed(grids: CasterGrids, mut faces: Vec<LitFace>) -> Self {
        let grids = CasterGrids { cells: (grids.cells / CASTER_CELLS).max(1), ..grids };
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (index, face) in (0..).zip(&faces) {
            let reach_m = REACH * face.area_vector.length().sqrt();
            for_cells_within(&grids, face.middle.truncate(), reach_m, |cell| {
                pairs.push((cell, index));
            });
        }
        let cells = grids.cell_count();
        let mut lists = vec![0; cells + 1 + pairs.len()];
        for &(cell, _) in &pairs {
            lists[cell as usize + 1] += 1;
        }
        let mut start = (cells + 1) as u32;
        for word in &mut lists[..=cells] {
            start += *word;
            *word = start;
        }
        let mut next = lists[..cells].to_vec();
        for (cell, face) in pairs {
            let place = &mut next[cell as usize];
            lists[*place as usize] = face;
            *place += 1;
        }
        faces.resize(faces.len().next_multiple_of(FACES_PER_ROW), LitFace::default());
        let has_faces = !faces.is_empty();
        let texels = bytemuck::cast_slice(&faces).to_vec();
        Self { lists, texels, has_faces, cells: grids.cells }
    }
}

/// Whether a rock is too small in the image to be a source of its own.
#[must_use]
pub fn is_speck(rock: &Rock, selected: &SelectedRock, pixel_angle: f32) -> bool {
    2.0 * rock.base_scale_m < (MIN_PX * pixel_angle).min(MIN_ANGLE) * selected.nearest_m
}

/// Calls `visit` with the cells within a distance of a point, of each grid those that no finer one covers.
fn for_cells_within(grids: &CasterGrids, point: Vec2, reach_m: f32, mut visit: impl FnMut(u32)) {
    let from_centre = point - grids.centre;
    let (nearest_m, furthest_m) =
        ((from_centre.abs() - reach_m).max_element(), (from_centre.abs() + reach_m).max_element());
    for level in 0..grids.levels {
        let half_m = grids.half_m * (1_u32 << level) as f32;
        let is_last = level + 1 == grids.levels;
        // With a margin: a device may round to the other side of a border.
        if (level > 0 && furthest_m < 0.499 * half_m) || (nearest_m > 1.001 * half_m && !is_last) {
            continue;
        }
        let cells = grids.cells as f32;
        let cell_m = 2.0 * half_m / cells;
        let index = |metres: f32| ((metres + half_m) / cell_m).floor().clamp(0.0, cells - 1.0) as u32;
        let reach_m = 1.01 * reach_m;
        let (low, high) = (from_centre - reach_m, from_centre + reach_m);
        // Along one axis, to the nearest point that a cell serves: those at the border also serve what lies beyond.
        let distance_m = |metres: f32, cell: u32| {
            let start_m = if cell == 0 { f32::MIN } else { cell as f32 * cell_m - half_m };
            let end_m = if cell + 1 == grids.cells { f32::MAX } else { (cell + 1) as f32 * cell_m - half_m };
            (start_m - metres).max(metres - end_m).max(0.0)
        };
        for row in index(low.y)..=index(high.y) {
            let across_m = distance_m(from_centre.y, row);
            for column in index(low.x)..=index(high.x) {
                let along_m = distance_m(from_centre.x, column);
                if along_m * along_m + across_m * across_m <= reach_m * reach_m {
                    visit((level * grids.cells + row) * grids.cells + column);
                }
            }
        }
    }
}

/// The part of a rock above the ground.
#[derive(Clone, Copy, Debug)]
pub struct Exposed {
    /// Point on the ground below its centre, metres, world.
    pub foot: Vec3,
    /// Height of its top above that, metres.
    pub height_m: f32,
}

impl Exposed {
    /// Of a rock on the scene's ground.
    #[must_use]
    pub fn new(scene: &Scene, rock: &Rock) -> Self {
        let position = rock.centre.truncate();
        let ground_m = scene.terrain.surface_height_at(position);
        let top_m = rock.centre.z + rock.z_range_m[1];
        Self { foot: position.extend(ground_m), height_m: (top_m - ground_m).max(0.1 * rock.base_scale_m) }
    }
}

/// The sunlit faces of a rock, without light and slot; zero where too little is sunlit.
fn faces(
    scene: &Scene,
    sunlight: &Sunlight<'_>,
    selected: &SelectedRock,
    exposed: &Exposed,
) -> [LitFace; FACES] {
    let rock = &scene.rocks[selected.rock];
    let sun = scene.sun.direction;
    let towards = sun.truncate().normalize_or(Vec2::X);
    let mut faces = [LitFace::default(); FACES];
    let mut areas_m2 = [0.0; FACES];
    for corners in &Icosphere::shared().triangles[COARSE_LEVEL.min(rock.level)] {
        let [a, b, c] = corners.map(|corner| rock.vertices[corner as usize].position);
        let area_vector = (0.5 / COARSE_AREA) * (b - a).cross(c - a);
        let middle = rock.centre + (a + b + c) / 3.0;
        if area_vector.dot(sun) <= 0.0 || middle.z < exposed.foot.z {
            continue;
        }
        let area_m2 = area_vector.length();
        let past_ground = sunlight.past_ground(middle);
        let sunlit = if past_ground > 0.0 {
            past_ground * sunlight.past_rocks(middle, 0.5 * area_m2.sqrt(), selected.rock)
        } else {
            0.0
        };
        let face = usize::from(area_vector.truncate().perp_dot(towards) > 0.0);
        faces[face].area_vector += sunlit * area_vector;
        faces[face].middle += sunlit * area_m2 * middle;
        areas_m2[face] += sunlit * area_m2;
    }
    let min_m2 = (MIN_AREA * rock.base_scale_m * rock.base_scale_m).max(f32::MIN_POSITIVE);
    for (face, area_m2) in faces.iter_mut().zip(areas_m2) {
        let is_too_small = face.area_vector.length() < min_m2;
        *face = if is_too_small {
            LitFace::default()
        } else {
            LitFace { middle: face.middle / area_m2, ..*face }
        };
    }
    faces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_is_listed_in_every_cell_that_it_reaches() {
        let grids = CasterGrids { centre: Vec2::new(3.0, -8.0), half_m: 4.0, cells: 192, levels: 5 };
        let faces: Vec<LitFace> = (0..40)
            .map(|k| {
                let (angle, distance_m) = (2.4 * f64::from(k), 1.3 * f64::from(k));
                let offset = distance_m * glam::DVec2::new(libm::cos(angle), libm::sin(angle));
                let middle = (grids.centre + offset.as_vec2()).extend(0.0);
                let size_m = 0.05 * (1 + k % 7) as f32;
                let area_vector = size_m * size_m * Vec3::X;
                LitFace { middle, area_vector, light: Vec3::ONE, slot: (k + 1) as f32, ..LitFace::default() }
            })
            .collect();
        let lit = LitRocks::listed(grids, faces.clone());
        assert_eq!(lit.texture_size(), [192, 1]);
        assert_eq!(lit.texels().len(), 192);
        assert_eq!(lit.texels()[3 * 7][3], 8.0, "the slot of face 7");
        let mut listed = 0;
        for (x, y) in (-300..300).flat_map(|x| (-300..300).map(move |y| (x, y))).step_by(17) {
            let from_centre = 0.2 * Vec2::new(x as f32 + 0.37, y as f32 + 0.11);
            let furthest_m = from_centre.abs().max_element();
            let level = (0..grids.levels).find(|level| furthest_m <= 4.0 * (1 << level) as f32).unwrap_or(4);
            let half_m = 4.0 * (1_u32 << level) as f32;
            let index = |metres: f32| ((metres + half_m) * 0.5 * lit.cells as f32 / half_m) as u32;
            let cell = (level * lit.cells + index(from_centre.y)) * lit.cells + index(from_centre.x);
            let [first, end] = [cell, cell + 1].map(|cell| lit.lists[cell as usize] as usize);
            let list = &lit.lists[first..end];
            for (index, face) in (0..).zip(&faces) {
                let distance_m = (grids.centre + from_centre).distance(face.middle.truncate());
                let is_reached = distance_m < REACH * face.area_vector.x.sqrt();
                assert!(!is_reached || list.contains(&index), "face {index} at {from_centre}");
            }
            listed += list.len();
        }
        assert!(listed > 100, "{listed}");
    }
}
