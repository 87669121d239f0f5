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

/// The axis-aligned bounding box of each block: lowest and highest corner, world, metres. Computed once per ground.
pub(crate) fn block_bounds(terrain: &Terrain) -> &[[Vec3; 2]] {
    terrain.block_bounds.get_or_init(|| {
        ground_blocks(terrain).map(|[columns, rows]| bounds_of_block(terrain, &columns, &rows)).collect()
    })
}

fn bounds_of_block(terrain: &Terrain, columns: &Range<u32>, rows: &Range<u32>) -> [Vec3; 2] {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let row_len = terrain.columns as usize + 1;
    for row in rows.start..=rows.end {
        let first = row as usize * row_len;
        for vertex in &terrain.vertices[first + columns.start as usize..=first + columns.end as usize] {
            let position = vertex.position.to_array();
            for axis in 0..3 {
                // `f32::min` is more than a comparison (NaN).
                low[axis] = if position[axis] < low[axis] { position[axis] } else { low[axis] };
                high[axis] = if position[axis] > high[axis] { position[axis] } else { high[axis] };
            }
        }
    }
    [low.into(), high.into()]
}
