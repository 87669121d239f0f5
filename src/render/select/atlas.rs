//! Packing rectangles into a larger one: the shadow atlas.
//!
//! The skyline algorithm with the bottom-left heuristic (Jylanki 2010, "A thousand ways to pack the bin", section 2.4). Rectangles that
//! are freed go to a list, from which the best fit is taken again; the skyline is never lowered.
//! Must not know: what the rectangles hold.

/// A rectangle in which smaller ones are allocated and freed.
#[derive(Clone, Debug, Default)]
pub(crate) struct AtlasAllocator {
    /// Columns and rows.
    size: [u32; 2],
    /// The skyline, from left to right: each segment by its first column and the first row that is free above it.
    skyline: Vec<[u32; 2]>,
    /// Freed rectangles.
    free: Vec<Allocation>,
}

/// A rectangle of the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Allocation {
    /// First column and first row.
    pub corner: [u32; 2],
    /// Its columns and rows. A smaller rectangle may be allocated here after this one is freed.
    size: [u32; 2],
}

impl Allocation {
    const fn area(&self) -> u64 {
        self.size[0] as u64 * self.size[1] as u64
    }
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

    /// Allocates a rectangle of `size` columns and rows; `None` if none fits.
    pub(crate) fn allocate(&mut self, size: [u32; 2]) -> Option<Allocation> {
        let wanted = Allocation { corner: [0; 2], size };
        let fits = |freed: &Allocation| freed.size[0] >= size[0] && freed.size[1] >= size[1];
        let fitting = self.free.iter().enumerate().filter(|(_, freed)| fits(freed));
        let tightest = fitting.min_by_key(|(_, freed)| freed.area()).map(|(index, _)| index);
        // A freed one that is much too large is left to others while the skyline has room.
        let snug = tightest.filter(|&index| 4 * self.free[index].area() <= 9 * wanted.area());
        match (snug, self.bottom_left(size), tightest) {
            (Some(index), _, _) | (None, None, Some(index)) => Some(self.free.swap_remove(index)),
            (None, Some(corner), _) => Some(self.raise(Allocation { corner, size })),
            (None, None, None) => None,
        }
    }

    /// Frees a rectangle.
    pub(crate) fn free(&mut self, allocation: Allocation) {
        self.free.push(allocation);
    }

    /// The position on the skyline where a rectangle lies in the lowest row, and of these the leftmost.
    fn bottom_left(&self, [columns, rows]: [u32; 2]) -> Option<[u32; 2]> {
        let [width, height] = self.size;
        let mut best: Option<[u32; 2]> = None;
        for (first, [column, own_row]) in self.skyline.iter().enumerate() {
            if column + columns > width {
                break;
            }
            // Segments as high as the best position, or higher, cannot give a lower one.
            let is_lower = |row: u32| best.is_none_or(|[best_row, _]| row < best_row);
            if !is_lower(*own_row) {
                continue;
            }
            let below = self.skyline[first..].iter().take_while(|[other, _]| *other < column + columns);
            let row = below.map(|[_, row]| *row).max().unwrap_or(0);
            if is_lower(row) {
                best = Some([row, *column]);
            }
        }
        best.filter(|[row, _]| row + rows <= height).map(|[row, column]| [column, row])
    }

    /// Raises the skyline by a rectangle.
    fn raise(&mut self, raised: Allocation) -> Allocation {
        let ([column, row], [columns, rows]) = (raised.corner, raised.size);
        let end = column + columns;
        let first = self.skyline.partition_point(|[other, _]| *other < column);
        let behind = self.skyline.partition_point(|[other, _]| *other < end);
        // The last segment below the rectangle may reach beyond it.
        let goes_on = self.skyline.get(behind).map_or(self.size[0], |[other, _]| *other) > end;
        let rest = goes_on.then_some([end, self.skyline[behind - 1][1]]);
        self.skyline.splice(first..behind, [[column, row + rows]].into_iter().chain(rest));
        raised
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_disjoint(rectangles: &[(Allocation, [u32; 2])], size: [u32; 2]) {
        for (i, (a, own)) in rectangles.iter().enumerate() {
            assert!((0..2).all(|axis| a.corner[axis] + own[axis] <= size[axis]), "{a:?}");
            for (b, other) in &rectangles[i + 1..] {
                let disjoint = |axis: usize| {
                    a.corner[axis] + own[axis] <= b.corner[axis]
                        || b.corner[axis] + other[axis] <= a.corner[axis]
                };
                assert!(disjoint(0) || disjoint(1), "{a:?} of {own:?}, {b:?} of {other:?}");
            }
        }
    }

    #[test]
    fn squares_are_disjoint_and_waste_less_than_a_quarter() {
        let mut sides: Vec<u32> = (0..200).map(|i| 16 + (i * 37) % 150).collect();
        sides.sort_unstable_by(|a, b| b.cmp(a));
        let area: u32 = sides.iter().map(|side| side * side).sum();
        let mut atlas = AtlasAllocator::new([1024, 4096]);
        let allocate = |&side: &u32| (atlas.allocate([side; 2]).expect("room"), [side; 2]);
        let squares: Vec<_> = sides.iter().map(allocate).collect();
        assert_disjoint(&squares, atlas.size());
        let rows = squares.iter().map(|(square, [_, side])| square.corner[1] + side).max().unwrap_or(0);
        assert!(1024 * rows < area + area / 4, "{rows} rows for {area}");
    }

    #[test]
    fn freed_squares_are_allocated_again() {
        let mut atlas = AtlasAllocator::new([64, 64]);
        let mut squares: Vec<_> =
            (0..16).map(|_| (atlas.allocate([16; 2]).expect("room"), [16; 2])).collect();
        assert_eq!(atlas.allocate([1; 2]), None);
        for (change, side) in [12, 16, 9, 16, 10, 16].into_iter().cycle().take(60).enumerate() {
            let (square, _) = squares.swap_remove(change * 7 % 16);
            atlas.free(square);
            squares.push((atlas.allocate([side; 2]).expect("room"), [side; 2]));
            assert_disjoint(&squares, atlas.size());
            assert_eq!(atlas.allocate([1; 2]), None);
        }
    }

    #[test]
    fn a_freed_rectangle_serves_what_is_no_wider_and_no_higher() {
        let mut atlas = AtlasAllocator::new([64, 32]);
        let [wide, high] = [[48, 32], [16, 32]].map(|size| atlas.allocate(size).expect("room"));
        assert_disjoint(&[(wide, [48, 32]), (high, [16, 32])], atlas.size());
        atlas.free(wide);
        atlas.free(high);
        assert_eq!(atlas.allocate([49, 1]), None);
        assert_eq!(atlas.allocate([16, 30]), Some(high), "it is the tightest");
        assert_eq!(atlas.allocate([16, 30]), Some(wide), "it is the only one left");
        assert_eq!(atlas.allocate([1, 1]), None);
    }
}
