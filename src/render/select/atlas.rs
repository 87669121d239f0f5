//! Squares side by side in a rectangle.
//! Must not know: what they hold.

/// A rectangle that squares are placed in and taken from.
#[derive(Clone, Debug, Default)]
pub struct Atlas {
    /// Columns and rows.
    size: [u32; 2],
    /// From the left to the right, where the first free row above all that was placed changes: column and that row.
    skyline: Vec<[u32; 2]>,
    /// What squares were taken from.
    free: Vec<Room>,
}

/// Room of a square.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Column and row where it begins.
    pub corner: [u32; 2],
    /// Its side: that of what was placed there first, and others may be smaller.
    side: u32,
}

impl Atlas {
    /// An empty one of so many columns and rows.
    #[must_use]
    pub fn new(size: [u32; 2]) -> Self {
        Self { size, skyline: vec![[0, 0]], free: Vec::new() }
    }

    /// Columns and rows.
    #[must_use]
    pub const fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Finds room for a square; `None` if there is no more.
    pub fn place(&mut self, side: u32) -> Option<Room> {
        let fitting = self.free.iter().enumerate().filter(|(_, room)| room.side >= side);
        let tightest = fitting.min_by_key(|(_, room)| room.side).map(|(place, _)| place);
        // Room that is much too large is left to others while there is more.
        let snug = tightest.filter(|&place| 2 * self.free[place].side <= 3 * side);
        match (snug, self.lowest(side), tightest) {
            (Some(place), _, _) | (None, None, Some(place)) => Some(self.free.swap_remove(place)),
            (None, Some(corner), _) => Some(self.raise(corner, side)),
            (None, None, None) => None,
        }
    }

    /// Takes a square away.
    pub fn remove(&mut self, room: Room) {
        self.free.push(room);
    }

    /// Where a square comes to lie lowest on the skyline, and of these furthest to the left.
    fn lowest(&self, side: u32) -> Option<[u32; 2]> {
        let [width, height] = self.size;
        let steps = self.skyline.iter().enumerate();
        let lying_at =
            steps.take_while(|(_, [column, _])| column + side <= width).map(|(first, [column, _])| {
                let below = self.skyline[first..].iter().take_while(|[other, _]| *other < column + side);
                [below.map(|[_, row]| *row).max().unwrap_or(0), *column]
            });
        lying_at.min().filter(|[row, _]| row + side <= height).map(|[row, column]| [column, row])
    }

    /// Raises the skyline by a square.
    fn raise(&mut self, corner: [u32; 2], side: u32) -> Room {
        let [column, row] = corner;
        let end = column + side;
        let first = self.skyline.partition_point(|[other, _]| *other < column);
        let behind = self.skyline.partition_point(|[other, _]| *other < end);
        let goes_on = self.skyline.get(behind).map_or(self.size[0], |[other, _]| *other) > end;
        let rest = goes_on.then_some([end, self.skyline[behind - 1][1]]);
        self.skyline.splice(first..behind, [[column, row + side]].into_iter().chain(rest));
        Room { corner, side }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_apart(placed: &[(Room, u32)], size: [u32; 2]) {
        for (i, (a, side)) in placed.iter().enumerate() {
            assert!((0..2).all(|axis| a.corner[axis] + side <= size[axis]), "{a:?}");
            for (b, other) in &placed[i + 1..] {
                let apart = |axis: usize| {
                    a.corner[axis] + side <= b.corner[axis] || b.corner[axis] + other <= a.corner[axis]
                };
                assert!(apart(0) || apart(1), "{a:?} of {side}, {b:?} of {other}");
            }
        }
    }

    #[test]
    fn squares_lie_apart_and_close_together() {
        let mut sides: Vec<u32> = (0..200).map(|i| 16 + (i * 37) % 150).collect();
        sides.sort_unstable_by(|a, b| b.cmp(a));
        let area: u32 = sides.iter().map(|side| side * side).sum();
        let mut atlas = Atlas::new([1024, 4096]);
        let placed: Vec<_> = sides.iter().map(|&side| (atlas.place(side).expect("room"), side)).collect();
        assert_apart(&placed, atlas.size());
        let rows = placed.iter().map(|(room, side)| room.corner[1] + side).max().unwrap_or(0);
        assert!(1024 * rows < area + area / 4, "{rows} rows for {area}");
    }

    #[test]
    fn what_was_taken_away_makes_room() {
        let mut atlas = Atlas::new([64, 64]);
        let mut placed: Vec<_> = (0..16).map(|_| (atlas.place(16).expect("room"), 16)).collect();
        assert_eq!(atlas.place(1), None);
        for (change, side) in [12, 16, 9, 16, 10, 16].into_iter().cycle().take(60).enumerate() {
            let (room, _) = placed.swap_remove(change * 7 % 16);
            atlas.remove(room);
            placed.push((atlas.place(side).expect("room"), side));
            assert_apart(&placed, atlas.size());
            assert_eq!(atlas.place(1), None);
        }
    }
}
