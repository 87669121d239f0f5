//! Tests of the light of sunlit ground, against rays.

use std::f32::consts::TAU;

use glam::Vec2;

use super::*;
use crate::scene::bounce::Bounce;
use crate::scene::photometry::{Law, Photometry};
use crate::scene::terrain::Terrain;

/// Index of the cell at a point, of the finest grid that covers it.
fn index(grids: NestedGrids, point: Vec2) -> usize {
    let indices = dispatch!(Level::new(), simd => {
        grids.locate_lanes(simd, 0, [splat(simd, point.x), splat(simd, point.y)]).indices
    });
    indices[0]
}

/// A crater of ten metres on a square of 64 m; its floor is in the shadow of its wall.
pub(in crate::render::select) fn height_m(point: Vec2) -> f32 {
    let part = (point.length() / 5.0).min(1.0);
    let depth = 1.0 - part * part;
    -2.0 * depth * depth
}

pub(in crate::render::select) fn crater() -> Terrain {
    Terrain::from_height(64.0, 512, Vec::new(), height_m)
}

pub(in crate::render::select) fn photometry() -> Photometry {
    Photometry { law: Law::Hapke, ..Photometry::default() }
}

/// A sun 12 degrees high.
pub(in crate::render::select) fn sun() -> Vec3 {
    Vec3::new(0.6 * 0.978_147_6, 0.8 * 0.978_147_6, 0.207_911_7)
}

fn map(terrain: &Terrain, is_needed: &[bool]) -> GroundLight {
    let bounce = Bounce::new(&photometry(), sun().z.into());
    let ground = GroundGrids::without_rocks(terrain, &photometry(), &bounce, sun());
    GroundLight::of_cells(&ground, is_needed)
}

fn all() -> Vec<bool> {
    vec![true; LEVELS * GRID_CELLS]
}

/// Irradiance on a normal of the ground at a place, as the shader finds it.
fn on_normal(map: &GroundLight, place: Vec2, normal: Vec3) -> f32 {
    let [level, sunward, leftward, _] = map.texels[texel_of(index(map.grids, place))];
    let (towards, slope) = (sun().truncate().normalize(), normal.truncate() / normal.z);
    let root = level + sunward * slope.dot(towards) + leftward * slope.dot(towards.perp());
    normal.z * root.max(0.0) * root.max(0.0)
}

fn slope(point: Vec2) -> Vec2 {
    let rise = |step: Vec2| (height_m(point + step) - height_m(point - step)) / (2.0 * step.length());
    Vec2::new(rise(0.01 * Vec2::X), rise(0.01 * Vec2::Y))
}

/// The place where a ray from a point meets the ground.
fn hit(start: Vec3, way: Vec3) -> Option<Vec2> {
    let places = (1..1200).map(|step| start + 0.02 * step as f32 * way);
    let mut below = places.filter(|place| place.z < height_m(place.truncate()));
    below.next().map(Vec3::truncate)
}

/// The same irradiance on any point by rays in all directions.
pub(in crate::render::select) fn by_rays(start: Vec3, normal: Vec3) -> f32 {
    let (rings, spokes) = (40, 60);
    let (across, along) = normal.any_orthonormal_pair();
    let mut sum = 0.0;
    for (ring, spoke) in (0..rings).flat_map(|ring| (0..spokes).map(move |spoke| (ring, spoke))) {
        // Of equal weight for the irradiance.
        let square = (ring as f32 + 0.5) / rings as f32;
        let (sin, cos) = libm::sincosf(TAU * (spoke as f32 + 0.5) / spokes as f32);
        let way = square.sqrt() * (cos * across + sin * along) + (1.0 - square).sqrt() * normal;
        let Some(at) = hit(start, way) else { continue };
        let of_ground = (-slope(at)).extend(1.0).normalize();
        let cosines = [of_ground.dot(sun()), -of_ground.dot(way), -way.dot(sun())].map(f64::from);
        if cosines[0] > 0.0 && hit(at.extend(height_m(at) + 0.01), sun()).is_none() {
            sum += photometry().soil.radiance_factor(cosines[0], cosines[1], cosines[2]);
        }
    }
    let photometry = photometry();
    let exitance = photometry.exitance(sun().z.into()) * photometry.at_normal(photometry.soil.b_s0);
    (sum / f64::from(rings * spokes) / exitance) as f32
}

#[test]
fn light_on_a_crater_s_floor_is_that_of_rays_to_its_wall() {
    let map = map(&crater(), &all());
    let towards = sun().truncate().normalize();
    // On the floor and up the wall that casts the shadow, with normals of their own and leaning.
    for (from_centre_m, expected_at_least) in [(0.0, 0.005), (1.0, 0.01), (2.0, 0.05), (3.0, 0.1)] {
        let index = index(map.grids, from_centre_m * towards);
        let place = map.grids.position(index);
        let own = -slope(place);
        for lean in [Vec2::ZERO, 0.15 * towards, -0.15 * towards, 0.15 * towards.perp()] {
            let normal = (own + lean).extend(1.0).normalize();
            let (found, expected) =
                (on_normal(&map, place, normal), by_rays(place.extend(height_m(place) + 0.01), normal));
            assert!(expected > expected_at_least, "{from_centre_m} m, {lean}: {expected}");
            let ratio = found / expected;
            assert!((0.75..1.33).contains(&ratio), "{from_centre_m} m, {lean}: {found}, not {expected}");
        }
    }
}

/// The ground of a cell is sunlit as its heights say; above the floor of the crater the middle of them is where a ray towards the sun clears
/// the wall.
#[test]
fn the_sun_comes_up_above_a_cell_where_rays_clear_the_ground() {
    let bounce = Bounce::new(&photometry(), sun().z.into());
    let ground = GroundGrids::without_rocks(&crater(), &photometry(), &bounce, sun());
    for (index, cell) in ground.cells.iter().enumerate() {
        let [lower_m, upper_m] = cell.limbs_m;
        let part = ((cell.height_m - upper_m) / (lower_m - upper_m)).clamp(0.0, 1.0);
        // What is wholly in the dark or in the light is so by both, but for rounding.
        let ends = [part, cell.sunlit].map(|part| (part - 0.5).abs() > 0.499);
        assert!(lower_m > upper_m && ends[0] == ends[1], "cell {index}: {part}, {}", cell.sunlit);
        assert!(!ends[0] || (part - cell.sunlit).abs() < 2e-3, "cell {index}: {part}, {}", cell.sunlit);
        let place = ground.grids.position(index);
        assert_eq!(ground.grids.index_at(place), self::index(ground.grids, place));
    }
    let towards = sun().truncate().normalize();
    for from_centre_m in [-1.0, 0.0, 1.0, 2.0] {
        let place = from_centre_m * towards;
        let [lower_m, upper_m] = ground.cells[ground.grids.index_at(place)].limbs_m;
        let is_lit = |height_m: &f32| hit(place.extend(*height_m), sun()).is_none();
        let clear_m = (0..400).map(|k| height_m(place) + 0.01 * k as f32).find(is_lit).expect("a height");
        let middle_m = 0.5 * (lower_m + upper_m);
        assert!((middle_m - clear_m).abs() < 0.3, "{from_centre_m} m: {middle_m}, not {clear_m}");
    }
}

#[test]
fn flat_ground_lights_no_ground() {
    let flat = map(&Terrain::from_height(64.0, 64, Vec::new(), |_| 1.0), &all());
    for texel in &flat.texels[..LEVELS * GRID_CELLS] {
        assert!(texel[0].abs() < 1e-3, "{texel:?}");
    }
}

/// Which cells are in view changes none of their values.
#[test]
fn values_do_not_depend_on_what_else_is_in_view() {
    let terrain = crater();
    let corners = [(-3.0, -2.0), (4.0, -1.0), (2.0, 3.0)].map(|(x, y)| Vec2::new(x, y));
    let grids = NestedGrids::new(&terrain);
    let is_needed = needed(grids, &Footprint::hull(corners.into_iter()));
    let (part, whole) = (map(&terrain, &is_needed), map(&terrain, &all()));
    let needed: Vec<usize> = (0..is_needed.len()).filter(|index| is_needed[*index]).collect();
    assert!(needed.iter().any(|index| *index >= (LEVELS - 1) * GRID_CELLS), "the border, for ground beyond");
    assert!((100..GRID_CELLS).contains(&needed.len()), "{}", needed.len());
    for index in needed {
        for first in [0, LEVELS * GRID_CELLS] {
            let texel = first + texel_of(index);
            assert_eq!(part.texels[texel], whole.texels[texel], "cell {index}");
        }
    }
    // Those that the shader reads around a place in view.
    let cell_m = grids.cell_m(0);
    for corner in [Vec2::new(-1.0, -1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, -1.0)] {
        assert!(is_needed[index(grids, Vec2::new(-3.0, -2.0) + 0.5 * cell_m * corner)]);
    }
}
