//! Where the grids of a horizon map lie in its image, a texture.
//! Must not know: what a grid holds.

use super::occluders::Limbs;
use crate::render::settings::DEFAULT_TEXTURE_PX;

/// Maximum rows of the image of several grids: as many as a texture has on every device.
const MAX_ROWS: usize = 2048;

/// A column of the image of a map: grids one below the other, as wide as the widest.
#[derive(Clone, Copy, Debug, Default)]
struct GridColumn {
    first_texel: usize,
    width: usize,
    rows: usize,
}

/// Where the grids lie in the image of a map: in columns of at most [`MAX_ROWS`], or of a single grid.
#[derive(Debug, Default)]
pub(super) struct ImageLayout {
    columns: Vec<GridColumn>,
    /// First column and row of each grid.
    pub(super) corners: Vec<[usize; 2]>,
}

/// The rows of an image that a grid lies in, and its first column there.
pub(super) struct ImageRows<'a> {
    pub(super) texels: &'a mut [Limbs],
    pub(super) width: usize,
    pub(super) column: usize,
}

impl ImageLayout {
    /// The layout of grids of these columns and rows.
    pub(super) fn new(sizes: impl Iterator<Item = [usize; 2]>) -> Self {
        let mut layout = Self::default();
        for [width, rows] in sizes {
            let columns = &mut layout.columns;
            if columns.last().is_none_or(|column| column.rows + rows > MAX_ROWS) {
                let first_texel = columns.last().map_or(0, |column| column.first_texel + column.width);
                columns.push(GridColumn { first_texel, ..GridColumn::default() });
            }
            let column = columns.last_mut().expect("pushed");
            layout.corners.push([column.first_texel, column.rows]);
            column.width = column.width.max(width);
            column.rows += rows;
        }
        layout
    }

    /// Columns and rows of the image.
    pub(super) fn size(&self) -> [usize; 2] {
        let rows = self.columns.iter().map(|column| column.rows).max().unwrap_or(0);
        [self.columns.iter().map(|column| column.width).sum(), rows]
    }

    /// Whether a texture of `max_texture_px` columns and rows can hold the image.
    pub(super) fn fits(&self, max_texture_px: u32) -> bool {
        self.size().into_iter().all(|side| side <= DEFAULT_TEXTURE_PX.min(max_texture_px) as usize)
    }
}
