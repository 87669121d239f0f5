//! Where a point lies in the ground's grid.
//!
//! Must not know: how the grid lies over the plane.

/// A cell of the ground's grid and a point within it.
#[derive(Clone, Copy, Debug)]
pub struct CellPoint {
    /// Column of the cell.
    pub column: u32,
    /// Row of the cell.
    pub row: u32,
    /// Along the row, 0 to 1.
    pub u: f32,
    /// Across the rows, 0 to 1.
    pub v: f32,
}
