//! Blocks of ground cells: the unit in which the ground is culled and drawn.
//! Must not know: the camera.

use std::ops::Range;

use glam::Vec3;

use crate::scene::terrain::Terrain;

/// Cells along a side of a block of ground that is culled as one.
pub(crate) const BLOCK_CELLS: u32 = 30;

/// The ranges of cell columns and cell rows of each block, row by row. Blocks at the end of a row or column may be smaller.
pub(crate) fn ground_blocks(terrain: &Terrain) -> impl Iterator<Item = [Range<u32>; 2]> + use<> {
    let spans = |cells: u32| {
        (0..cells).step_by(BLOCK_CELLS as usize).map(move |first| first..(first + BLOCK_CELLS).min(cells))
    };
    let (columns, rows) = (terrain.columns, terrain.rows);
    spans(rows).flat_map(move |rows| spans(columns).map(move |columns| [columns, rows.clone()]))
}

/// The axis-aligned bounding box of a block: lowest and highest corner, world, metres.
pub(crate) fn block_bounds(terrain: &Terrain, columns: &Range<u32>, rows: &Range<u32>) -> (Vec3, Vec3) {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let row_len = terrain.columns as usize + 1;
    for row in rows.start..=rows.end {
        let first = row as usize * row_len;
        for vertex in &terrain.vertices[first + columns.start as usize..=first + columns.end as usize] {
            low = low.min(vertex.position);
            high = high.max(vertex.position);
        }
    }
    (low, high)
}
