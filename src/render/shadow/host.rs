//! The shadow map on the CPU, for software adapters.
//!
//! CPU counterpart of `shadow.wgsl` and `shadow_midpoint.wgsl`: midpoint shadow maps (Woo 1992, "The shadow depth map revisited", in
//! Graphics Gems III).
//! Must not know: textures.

use std::cell::RefCell;
use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8, mask32x8};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::gpu::staging::{Page, PageWriter};
use crate::render::device::shader_structs::CasterTile;
use crate::render::raster::cull::{CULL_BATCH, CullMode, Survivors, Winding};
use crate::render::raster::fill::FragmentSink;
use crate::render::raster::fixed_point::{SUBPIXEL_STEPS, SubpixelPoint};
use crate::render::raster::lanes::{
    BLOCK_HEIGHT, BLOCK_WIDTH, LANES, VERTEX_BATCH, load_block, store_block, to_soa,
};
use crate::render::raster::setup::{Interpolant, TriangleSetup};
use crate::render::raster::setup8::{TriangleSetup8, TriangleVertices8};
use crate::render::select::casters::DEPTH_RANGE_PX;
use crate::render::shadow::tiles::{Band, BandRows, NewTile};
use crate::scene::Scene;
use crate::scene::mesh::{Icosphere, Vertex};

/// Height where a tile has no caster, texels. `shadow_midpoint.wgsl` has the same.
pub(crate) const NO_CASTER: f32 = -1.0e9;
/// How far the surface that is stored lies behind the front at most, texels: midway to the back would leave light in creases. The
/// plane of what a crease shadows is extended to texels before the crease, and there it lies in the rock, behind the front, but before the
/// middle of what is thick. On surfaces that face the sun and are not flat it lies less far behind the front. Nominal rocks that face the
/// sun are wrong by over a quarter in 2.1 % of their pixels with 2 to 4 texels, in 2.4 % with 8, in 2.8 % without a limit; those of the
/// surface stage in 0.9 to 0.7, 0.7 and 0.7 % (14 frames, three texels a pixel).
pub(crate) const MAX_BEHIND_FRONT_PX: f32 = 4.0;
thread_local! {
    /// One per thread, so that its memory is reused.
    static BAND: RefCell<ShadowBand> = RefCell::default();
}

/// Rasterises bands of tiles into staging memory, laid out as by `upload_regions`.
pub fn rasterise(scene: &Scene, bands: &[Band<'_>], pages: &mut dyn Iterator<Item = Page<'_>>) {
    let with_pages = |band| (band, pages.take(Band::pages(band)).collect());
    let bands: Vec<(&Band<'_>, Vec<Page<'_>>)> = bands.iter().map(with_pages).collect();
    // One band at a time per thread: their costs differ widely.
    bands.into_par_iter().with_max_len(1).for_each(|(Band { strip, rows }, pages)| {
        let (row_bytes, writer) = (strip.row_bytes(), PageWriter::new(pages));
        BAND.with_borrow_mut(|band| match strip.tiles {
            [tile] => {
                band.draw(scene, tile, rows.clone());
                band.write_midpoints(row_bytes, writer);
            }
            tiles => band.write_strip(scene, tiles, rows, row_bytes, writer),
        });
    });
}

/// A vertex of a caster in its tile.
#[derive(Clone, Copy, Debug)]
struct ShadowVertex {
    position: SubpixelPoint,
    /// The same before it is rounded, texels from the centre of the first.
    position_px: Vec2,
    /// Reversed: 1 is nearest to the sun, 0.5 at the caster's centre, and a texel of the tile is 1 / [`DEPTH_RANGE_PX`].
    depth: f32,
}

/// A band of rows of a tile.
#[derive(Debug, Default)]
struct ShadowBand {
    /// Columns of the tile that are wanted; the layers have those before them too.
    columns: Range<usize>,
    rows: BandRows,
    /// Texels from one row of a layer to the next.
    stride: usize,
    /// Wanted columns and rows of the tile that the caster may cover. Elsewhere the layers hold anything.
    covered: [Range<usize>; 2],
    /// Greatest depth of the faces towards the sun ([`Winding::Front`]), and of those away from it; 0 where there is none.
    layers: [Vec<f32>; 2],
    vertices: Vec<ShadowVertex>,
    /// A row as it is written.
    midpoint_row: Vec<f32>,
    /// The rows of a strip of several tiles.
    strip: Vec<f32>,
}

impl ShadowBand {
    /// Draws these rows of a tile.
    fn draw(&mut self, scene: &Scene, tile: &NewTile, rows: BandRows) {
        let rock = &scene.rocks[tile.rock];
        let vertices = &rock.vertices[..Icosphere::vertex_count(tile.level)];
        self.restart(tile.texels.columns.clone(), rows);
        dispatch!(Level::new(), simd => {
            self.project(&tile.tile, scene, vertices);
            self.clear();
            self.rasterise(simd, rock.triangles(tile.level));
        });
    }

    /// Restarts it for these columns and rows of a tile.
    fn restart(&mut self, columns: Range<usize>, rows: BandRows) {
        self.stride = columns.end + BLOCK_WIDTH;
        (self.columns, self.rows) = (columns, rows);
        self.vertices.clear();
    }

    /// Finds what the projected caster may cover, and clears the layers there.
    fn clear(&mut self) {
        let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
        for ShadowVertex { position: SubpixelPoint { x, y }, .. } in &self.vertices {
            low = [low[0].min(*x), low[1].min(*y)];
            high = [high[0].max(*x), high[1].max(*y)];
        }
        let span = |axis: usize, texels: &Range<usize>| {
            let within = |texel: i32| (texel.max(0) as usize).clamp(texels.start, texels.end);
            let first = within(low[axis].div_euclid(SUBPIXEL_STEPS));
            first..within(high[axis].div_euclid(SUBPIXEL_STEPS).saturating_add(2)).max(first)
        };
        self.covered = [span(0, &self.columns), span(1, &self.rows.written)];
        let [columns, rows] = &self.covered;
        for layer in &mut self.layers {
            let texels = self.stride * (self.rows.len() + BLOCK_HEIGHT);
            layer.reserve_exact(texels.saturating_sub(layer.len()));
            layer.resize(texels, 0.0);
            for row in rows.clone() {
                let first = (row - self.rows.first) * self.stride;
                layer[first + columns.start..first + columns.end].fill(0.0);
            }
        }
    }

    /// Projects a caster's vertices onto its tile: an orthographic view from the sun.
    #[inline(always)]
    fn project(&mut self, tile: &CasterTile, scene: &Scene, vertices: &[Vertex]) {
        let [right, up] = scene.sun.right_and_up();
        let (right, down, to_sun) = (right, -up, scene.sun.direction);
        let half = 0.5 / tile.half_extent_m;
        let size_px = tile.size_px;
        let depth_range = size_px / DEPTH_RANGE_PX;
        for vertices in vertices.chunks(VERTEX_BATCH) {
            let [x, y, z] = to_soa(vertices.iter().map(|vertex| vertex.position));
            let (mut position_px, mut depth) = ([[0.0; VERTEX_BATCH]; 2], [0.0; VERTEX_BATCH]);
            let mut position = [[0; VERTEX_BATCH]; 2];
            for i in 0..VERTEX_BATCH {
                let p = [half * x[i], half * y[i], half * z[i]];
                position_px[0][i] = (0.5 + dot(p, right)) * size_px - 0.5;
                position_px[1][i] = (0.5 + dot(p, down)) * size_px - 0.5;
                position[0][i] = SubpixelPoint::steps(position_px[0][i]);
                position[1][i] = SubpixelPoint::steps(position_px[1][i]);
                depth[i] = 0.5 + dot(p, to_sun) * depth_range;
            }
            self.vertices.extend((0..vertices.len()).map(|i| ShadowVertex {
                position: SubpixelPoint { x: position[0][i], y: position[1][i] },
                position_px: Vec2::new(position_px[0][i], position_px[1][i]),
                depth: depth[i],
            }));
        }
    }

    // `inline(always)` all the way down to the fill loop, so that `dispatch!` compiles it for each vector width.
    #[inline(always)]
    fn rasterise<S: Simd>(&mut self, simd: S, triangles: &[[u32; 3]]) {
        let Self { columns, rows, stride, layers, vertices, .. } = self;
        let (size, stride) = (columns.end, *stride);
        let written = rows.written.start as i32..rows.written.end as i32;
        let rows = rows.first as i32..written.end;
        let position_of = |vertex: u32| vertices[vertex as usize].position;
        for triangles in triangles.chunks(CULL_BATCH) {
            let survivors = Survivors::cull(simd, triangles, position_of, CullMode::None, size, &written);
            for eight in survivors.indices().chunks(LANES) {
                let mut vertices8 = TriangleVertices8::EMPTY;
                for (lane, &index) in eight.iter().enumerate() {
                    for (corner, &vertex) in triangles[usize::from(index)].iter().enumerate() {
                        let ShadowVertex { position, position_px, depth } = vertices[vertex as usize];
                        vertices8.set(lane, corner, position, position_px, [depth]);
                    }
                }
                let setup8 = TriangleSetup8::new(simd, &vertices8, size, &rows);
                for (lane, &index) in eight.iter().enumerate() {
                    if setup8.is_small(lane) {
                        let [depth] = setup8.interpolants(lane);
                        let layer = &mut layers[setup8.winding(lane) as usize];
                        let corners = triangles[usize::from(index)].map(|vertex| vertices[vertex as usize]);
                        let mut writer = DepthWriter { layer, depth, range: depth_range(corners) };
                        setup8.fill(simd, lane, rows.start, stride, &mut writer);
                    } else {
                        let corners = triangles[usize::from(index)].map(|vertex| vertices[vertex as usize]);
                        rasterise_large(simd, corners, layers, size, &rows);
                    }
                }
            }
        }
    }

    /// Writes the heights of the map, `row_bytes` from one row to the next.
    fn write_midpoints(&mut self, row_bytes: usize, mut writer: PageWriter<'_>) {
        let mut midpoint_row = std::mem::take(&mut self.midpoint_row);
        midpoint_row.resize(self.columns.len(), 0.0);
        for row in self.rows.written.clone() {
            self.set_midpoint_row(row, &mut midpoint_row);
            writer.write_row(bytemuck::cast_slice(&midpoint_row), row_bytes);
        }
        self.midpoint_row = midpoint_row;
    }

    /// Draws whole tiles of equal size and writes the same of all of them, side by side.
    fn write_strip(
        &mut self,
        scene: &Scene,
        tiles: &[NewTile],
        rows: &BandRows,
        row_bytes: usize,
        mut writer: PageWriter<'_>,
    ) {
        let size = tiles.first().map_or(0, NewTile::size);
        let columns = (tiles.len() * size).max(1);
        let mut strip = std::mem::take(&mut self.strip);
        strip.resize(columns * rows.written.len(), 0.0);
        for (number, tile) in tiles.iter().enumerate() {
            self.draw(scene, tile, rows.clone());
            for (row, midpoints) in rows.written.clone().zip(strip.chunks_exact_mut(columns)) {
                self.set_midpoint_row(row, &mut midpoints[number * size..][..size]);
            }
        }
        for midpoints in strip.chunks_exact(columns) {
            writer.write_row(bytemuck::cast_slice(midpoints), row_bytes);
        }
        self.strip = strip;
    }

    /// Sets the heights of the map in a row of the tile, in the columns that are wanted: texels above the caster's centre.
    fn set_midpoint_row(&self, row: usize, midpoints: &mut [f32]) {
        let [columns, covered_rows] = &self.covered;
        if !covered_rows.contains(&row) {
            midpoints.fill(NO_CASTER);
            return;
        }
        let covered = columns.start - self.columns.start..columns.end - self.columns.start;
        midpoints[..covered.start].fill(NO_CASTER);
        midpoints[covered.end..].fill(NO_CASTER);
        let first = (row - self.rows.first) * self.stride;
        let [fronts, backs] =
            self.layers.each_ref().map(|layer| &layer[first + columns.start..first + columns.end]);
        dispatch!(Level::new(), _simd => set_midpoints(&mut midpoints[covered], fronts, backs));
    }
}

// Inlined into `dispatch!`, so that it is compiled for each SIMD level.
#[inline(always)]
fn set_midpoints(midpoints: &mut [f32], fronts: &[f32], backs: &[f32]) {
    for (midpoint, (front, back)) in midpoints.iter_mut().zip(fronts.iter().zip(backs)) {
        let depth = (0.5 * (front + back)).max(front - MAX_BEHIND_FRONT_PX / DEPTH_RANGE_PX);
        *midpoint = if *front == 0.0 { NO_CASTER } else { DEPTH_RANGE_PX * (depth - 0.5) };
    }
}

/// Dot product, in this order of sums.
#[inline(always)]
fn dot([x, y, z]: [f32; 3], axis: Vec3) -> f32 {
    x * axis.x + y * axis.y + z * axis.z
}

/// Rasterises a triangle of any size into the layer of its winding, into these rows of a tile of `size` columns.
#[inline(always)]
fn rasterise_large<S: Simd>(
    simd: S,
    [a, b, c]: [ShadowVertex; 3],
    layers: &mut [Vec<f32>; 2],
    size: usize,
    rows: &Range<i32>,
) {
    let Some(winding) = Winding::of([a.position, b.position, c.position]) else { return };
    let corners = if winding == Winding::Front { [a, b, c] } else { [a, c, b] };
    let Some(setup) = TriangleSetup::new(corners.map(|corner| corner.position), size, rows) else { return };
    let [depth] =
        setup.interpolants(corners.map(|corner| corner.position_px), corners.map(|corner| [corner.depth]));
    let mut writer = DepthWriter { layer: &mut layers[winding as usize], depth, range: depth_range(corners) };
    setup.fill(simd, rows.start, size + BLOCK_WIDTH, &mut writer);
}

/// The smallest and the largest depth of a triangle's corners.
#[inline(always)]
fn depth_range([a, b, c]: [ShadowVertex; 3]) -> [f32; 2] {
    [a.depth.min(b.depth).min(c.depth), a.depth.max(b.depth).max(c.depth)]
}

/// Raises a layer to the depth of a triangle.
struct DepthWriter<'a> {
    layer: &'a mut [f32],
    depth: Interpolant,
    /// See [`depth_range`]. A texel that is inside only after corners were rounded is extrapolated to, far off if the triangle is a sliver.
    range: [f32; 2],
}

impl<S: Simd> FragmentSink<S> for DepthWriter<'_> {
    #[inline(always)]
    fn write(&mut self, simd: S, offsets: [usize; 2], covered: mask32x8<S>, x: f32x8<S>, y: f32x8<S>) {
        let [lowest, highest] = self.range.map(|depth| f32x8::splat(simd, depth));
        let depth = self.depth.at(x, y).max(lowest).min(highest);
        let depth = covered.select(depth, f32x8::splat(simd, 0.0));
        let previous = load_block(simd, self.layer, offsets);
        store_block(self.layer, offsets, depth.max(previous));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::gpu::staging::PAGE_BYTES;
    use crate::params::Params;
    use crate::render::select::casters;
    use crate::render::select::selection::Selection;
    use crate::render::settings::{DEFAULT_TEXTURE_PX, RenderSettings};
    use crate::render::shadow::tiles::{ShadowMap, bands, upload_parts, upload_regions};
    use crate::scene::sky::Sun;

    /// The shadow map of a device.
    #[derive(Default)]
    struct Device {
        size_px: [u32; 2],
        texels: Vec<f32>,
    }

    impl Device {
        fn copy(&mut self, scene: &Scene, map: &ShadowMap, tiles: &[NewTile]) {
            if self.size_px != map.size_px() {
                self.size_px = map.size_px();
                self.texels = vec![f32::NAN; (self.size_px[0] * self.size_px[1]) as usize];
            }
            upload_parts(&bands(tiles), 1 << 18).for_each(|bands| self.copy_part(scene, bands));
        }

        fn copy_part(&mut self, scene: &Scene, bands: &[Band<'_>]) {
            let (regions, bytes) = upload_regions(bands);
            let mut staged = vec![[0_u8; PAGE_BYTES]; bytes / PAGE_BYTES];
            rasterise(scene, bands, &mut staged.iter_mut().map(Page::from_mut));
            let staged: Vec<f32> = bytemuck::pod_collect_to_vec(staged.as_flattened());
            for region in regions {
                let rows = staged[region.offset_bytes / size_of::<f32>()..]
                    .chunks(region.row_bytes / size_of::<f32>());
                let ([column, first], [width, height]) =
                    (region.origin.map(|at| at as usize), region.size.map(|side| side as usize));
                for (row, texels) in (first..first + height).zip(rows) {
                    let start = row * self.size_px[0] as usize + column;
                    self.texels[start..start + width].copy_from_slice(&texels[..width]);
                }
            }
        }

        /// The texels of each caster's tile.
        fn tiles(&self, selection: &Selection) -> Vec<Vec<f32>> {
            let tile = |caster: &casters::Caster| {
                let [column, first] = caster.tile.origin_px.to_array().map(|at| at as usize);
                let size = caster.tile.size_px as usize;
                let row = |row: usize| &self.texels[row * self.size_px[0] as usize + column..][..size];
                (first..first + size).flat_map(row).copied().collect()
            };
            selection.casters.iter().map(tile).collect()
        }
    }

    #[test]
    fn tiles_do_not_depend_on_earlier_frames() {
        let mut scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new([256, 256], 1).expect("settings");
        let (mut map, mut device) = (ShadowMap::default(), Device::default());
        let mut drawn = Vec::new();
        let still = scene.clone();
        for change in 0..40 {
            match change {
                // Nothing changes; then the sun; then the mesh of a rock; then the camera, again and again.
                0 | 1 => {}
                2 => scene.sun = Sun { direction: Vec3::new(0.3, 0.9, 0.31).normalize(), ..scene.sun },
                3 => Arc::make_mut(&mut scene.rocks[0].vertices).reverse(),
                _ => scene.camera.eye.x += 0.5,
            }
            let mut selection = Selection::new(&scene, &settings);
            let mut alone = selection.clone();
            let new = map.allocate(&scene, &mut selection, DEFAULT_TEXTURE_PX);
            device.copy(&scene, &map, &new);
            let (mut fresh, mut of_fresh) = (ShadowMap::default(), Device::default());
            let all = fresh.allocate(&scene, &mut alone, DEFAULT_TEXTURE_PX);
            of_fresh.copy(&scene, &fresh, &all);
            assert_eq!(device.tiles(&selection), of_fresh.tiles(&alone), "change {change}");
            drawn.push((new.len(), all.len()));
        }
        let [first, again, sun, rock, moved @ ..] = &drawn[..] else { panic!("forty frames") };
        assert_eq!(first.0, first.1);
        assert_eq!(again.0, 0);
        assert_eq!(sun.0, sun.1);
        assert_eq!(rock.0, 1);
        let (some, all) = moved.iter().fold((0, 0), |sum, few| (sum.0 + few.0, sum.1 + few.1));
        assert!(0 < some && 2 * some < all, "{moved:?}");
        assert!(Arc::ptr_eq(&still.rocks[1].vertices, &scene.rocks[1].vertices), "copies share meshes");
    }

    #[test]
    fn the_map_grows_no_further_than_it_must() {
        let scene = Scene::build(42, &Params::draw_default(42)).expect("the scene of the seed");
        let settings = RenderSettings::new([512, 512], 1).expect("settings");
        let mut selection = Selection::new(&scene, &settings);
        let mut map = ShadowMap::default();
        let new = map.allocate(&scene, &mut selection, DEFAULT_TEXTURE_PX);
        let area: f32 = new.iter().map(|tile| tile.tile.size_px * tile.tile.size_px).sum();
        let [width, height] = map.size_px();
        assert!(
            area < (width * height) as f32 && (width * height) as f32 <= 4.0 * area,
            "{width} x {height}"
        );
        // A smaller image has smaller tiles, and the map stays.
        let settings = RenderSettings::new([64, 64], 1).expect("settings");
        map.allocate(&scene, &mut Selection::new(&scene, &settings), DEFAULT_TEXTURE_PX);
        assert_eq!(map.size_px(), [width, height]);
    }
}
