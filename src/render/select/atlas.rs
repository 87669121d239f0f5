//! Packing squares into a rectangle: the shadow atlas.
//!
//! The skyline algorithm with the bottom-left heuristic (Jylanki 2010, "A thousand ways to pack the bin", section 2.4). Squares that
//! are freed go to a list, from which the best fit is taken again; the skyline is never lowered.
//! Must not know: what the squares hold.

/// A rectangle in which squares are allocated and freed.
#[derive(Clone, Debug, Default)]
pub(crate) struct AtlasAllocator {
    /// Columns and rows.
    size: [u32; 2],
    /// The skyline, from left to right: each segment by its first column and the first row that is free above it.
    skyline: Vec<[u32; 2]>,
    /// Freed squares.
    free: Vec<Allocation>,
}

/// A square of the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Allocation {
    /// First column and first row.
    pub corner: [u32; 2],
    /// Its side. A smaller square may be allocated here after this one is freed.
    side: u32,
}

impl AtlasAllocator {
    /// An empty atlas; `size` is its columns and rows.
    #[must_use]
    pub(crate) fn new(size: [u32; 2]) -> Self {
        Self { size, skyline: vec![[0, 0]], free: Vec::new() }
    }

    /// Columns and rows.
    #[must_use]
    pub(crate) const fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Allocates a square; `None` if none fits.
    pub(crate) fn allocate(&mut self, side: u32) -> Option<Allocation> {
        let fitting = self.free.iter().enumerate().filter(|(_, square)| square.side >= side);
        let tightest = fitting.min_by_key(|(_, square)| square.side).map(|(index, _)| index);
        // A freed square that is much too large is left to others while the skyline has room.
        let snug = tightest.filter(|&index| 2 * self.free[index].side <= 3 * side);
        match (snug, self.bottom_left(side), tightest) {
            (Some(index), _, _) | (None, None, Some(index)) => Some(self.free.swap_remove(index)),
            (None, Some(corner), _) => Some(self.raise(corner, side)),
            (None, None, None) => None,
        }
    }

    /// Frees a square.
    pub(crate) fn free(&mut self, allocation: Allocation) {
        self.free.push(allocation);
    }

    /// The position on the skyline where a square lies in the lowest row, and of these the leftmost.
    fn bottom_left(&self, side: u32) -> Option<[u32; 2]> {
        let [width, height] = self.size;
        let mut best: Option<[u32; 2]> = None;
        for (first, [column, own_row]) in self.skyline.iter().enumerate() {
            if column + side > width {
                break;
            }
            // Segments as high as the best position, or higher, cannot give a lower one.
            let is_lower = |row: u32| best.is_none_or(|[best_row, _]| row < best_row);
            if !is_lower(*own_row) {
                continue;
            }
            let below = self.skyline[first..].iter().take_while(|[other, _]| *other < column + side);
            let row = below.map(|[_, row]| *row).max().unwrap_or(0);
            if is_lower(row) {
                best = Some([row, *column]);
            }
        }
        best.filter(|[row, _]| row + side <= height).map(|[row, column]| [column, row])
    }

    /// Raises the skyline by a square.
    fn raise(&mut self, corner: [u32; 2], side: u32) -> Allocation {
        let [column, row] = corner;
        let end = column + side;
        let first = self.skyline.partition_point(|[other, _]| *other < column);
        let behind = self.skyline.partition_point(|[other, _]| *other < end);
        // The last segment below the square may reach beyond it.
        let goes_on = self.skyline.get(behind).map_or(self.size[0], |[other, _]| *other) > end;
        let rest = goes_on.then_some([end, self.skyline[behind - 1][1]]);
        self.skyline.splice(first..behind, [[column, row + side]].into_iter().chain(rest));
        Allocation { corner, side }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_disjoint(squares: &[(Allocation, u32)], size: [u32; 2]) {
        for (i, (a, side)) in squares.iter().enumerate() {
            assert!((0..2).all(|axis| a.corner[axis] + side <= size[axis]), "{a:?}");
            for (b, other) in &squares[i + 1..] {
                let disjoint = |axis: usize| {
                    a.corner[axis] + side <= b.corner[axis] || b.corner[axis] + other <= a.corner[axis]
                };
                assert!(disjoint(0) || disjoint(1), "{a:?} of {side}, {b:?} of {other}");
            }
        }
    }

    #[test]
    fn squares_are_disjoint_and_waste_less_than_a_quarter() {
        let mut sides: Vec<u32> = (0..200).map(|i| 16 + (i * 37) % 150).collect();
        sides.sort_unstable_by(|a, b| b.cmp(a));
        let area: u32 = sides.iter().map(|side| side * side).sum();
        let mut atlas = AtlasAllocator::new([1024, 4096]);
        let squares: Vec<_> = sides.iter().map(|&side| (atlas.allocate(side).expect("room"), side)).collect();
        assert_disjoint(&squares, atlas.size());
        let rows = squares.iter().map(|(square, side)| square.corner[1] + side).max().unwrap_or(0);
        assert!(1024 * rows < area + area / 4, "{rows} rows for {area}");
    }

    #[test]
    fn freed_squares_are_allocated_again() {
        let mut atlas = AtlasAllocator::new([64, 64]);
        let mut squares: Vec<_> = (0..16).map(|_| (atlas.allocate(16).expect("room"), 16)).collect();
        assert_eq!(atlas.allocate(1), None);
        for (change, side) in [12, 16, 9, 16, 10, 16].into_iter().cycle().take(60).enumerate() {
            let (square, _) = squares.swap_remove(change * 7 % 16);
            atlas.free(square);
            squares.push((atlas.allocate(side).expect("room"), side));
            assert_disjoint(&squares, atlas.size());
            assert_eq!(atlas.allocate(1), None);
        }
    }
}
