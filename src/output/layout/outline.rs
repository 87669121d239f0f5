//! The outline of a region of pixels as one polygon, as YOLO's segmentation labels have it.
//!
//! Must not know: frames, formats.

/// A corner of a pixel: column and row, from the image's top-left corner. Pixel (x, y) covers (x, y) to (x + 1, y + 1).
pub(super) type Corner = [u32; 2];

/// The outline of the pixels of `width` x `height` for which `is_inside` is true, as one closed polygon along the edges of pixels, without
/// its first corner at the end. Pixels that touch at a corner are connected. Holes are filled. The outlines of several parts are joined by
/// segments between their nearest corners, there and back, so that they enclose nothing: as `merge_multi_segment` of Ultralytics' converter
/// does. Empty if no pixel is inside.
pub(super) fn polygon([width, height]: [u32; 2], is_inside: impl Fn(u32, u32) -> bool) -> Vec<Corner> {
    let at = |x: u32, y: u32| (y * width + x) as usize;
    // What a hole encloses is no part of its own.
    let is_outside = outside([width, height], is_inside);
    let is_inside = |x: u32, y: u32| !is_outside[at(x, y)];
    let mut visited = vec![false; (width * height) as usize];
    let mut rings = Vec::new();
    for y in 0..height {
        for x in 0..width {
            // The first pixel of a part in reading order: nothing of it is above, nor left of it in this row.
            if is_inside(x, y) && !visited[at(x, y)] {
                rings.push(ring([width, height], [x, y], &is_inside));
                visit([width, height], [x, y], &is_inside, &mut visited);
            }
        }
    }
    joined(&rings)
}

/// Whether each pixel, row by row, is connected by sides with the border along pixels for which `is_inside` is false.
fn outside([width, height]: [u32; 2], is_inside: impl Fn(u32, u32) -> bool) -> Vec<bool> {
    let mut is_outside = vec![false; (width * height) as usize];
    let border = (0..width).flat_map(|x| [[x, 0], [x, height - 1]]);
    let mut waiting: Vec<[u32; 2]> =
        border.chain((0..height).flat_map(|y| [[0, y], [width - 1, y]])).collect();
    while let Some([x, y]) = waiting.pop() {
        let slot = &mut is_outside[(y * width + x) as usize];
        if *slot || is_inside(x, y) {
            continue;
        }
        *slot = true;
        let beside = [[x.wrapping_sub(1), y], [x + 1, y], [x, y.wrapping_sub(1)], [x, y + 1]];
        waiting.extend(beside.into_iter().filter(|[x, y]| *x < width && *y < height));
    }
    is_outside
}

/// Marks the pixels that are connected with one, by sides or corners.
fn visit(
    [width, height]: [u32; 2],
    start: [u32; 2],
    is_inside: &impl Fn(u32, u32) -> bool,
    visited: &mut [bool],
) {
    let mut waiting = vec![start];
    while let Some([x, y]) = waiting.pop() {
        let slot = &mut visited[(y * width + x) as usize];
        if *slot || !is_inside(x, y) {
            continue;
        }
        *slot = true;
        let (rows, columns) =
            (y.saturating_sub(1)..(y + 2).min(height), x.saturating_sub(1)..(x + 2).min(width));
        waiting.extend(rows.flat_map(|row| columns.clone().map(move |column| [column, row])));
    }
}

/// The outer outline of a part, clockwise from the top-left corner of its first pixel in reading order; only corners where it turns.
fn ring([width, height]: [u32; 2], [x, y]: [u32; 2], is_inside: &impl Fn(u32, u32) -> bool) -> Vec<Corner> {
    // Right, down, left, up; the inside is on the right of the direction.
    const STEPS: [[i64; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
    let inside = |[x, y]: [i64; 2]| {
        (0..i64::from(width)).contains(&x)
            && (0..i64::from(height)).contains(&y)
            && is_inside(x as u32, y as u32)
    };
    let start = [i64::from(x), i64::from(y)];
    let (mut corner, mut direction) = (start, 0);
    let mut ring = vec![[x, y]];
    loop {
        corner = [corner[0] + STEPS[direction][0], corner[1] + STEPS[direction][1]];
        // The pixels ahead of this corner, to the left and to the right of the direction.
        let [x, y] = corner;
        let around = [[x, y - 1], [x, y], [x - 1, y], [x - 1, y - 1]];
        let (left, right) = (around[direction], around[(direction + 1) % 4]);
        let turn = if inside(left) {
            3
        } else if inside(right) {
            0
        } else {
            1
        };
        let next = (direction + turn) % 4;
        if corner == start && next == 0 {
            return ring;
        }
        if turn != 0 {
            ring.push([corner[0] as u32, corner[1] as u32]);
        }
        direction = next;
    }
}

/// One polygon of several rings: each is walked to where the next is nearest, which is inserted there.
fn joined(rings: &[Vec<Corner>]) -> Vec<Corner> {
    let bridges: Vec<[usize; 2]> = rings.windows(2).map(|pair| nearest(&pair[0], &pair[1])).collect();
    let mut tail: Vec<Corner> = Vec::new();
    for (i, ring) in rings.iter().enumerate().rev() {
        let entry = i.checked_sub(1).map_or(0, |before| bridges[before][1]);
        let exit = bridges.get(i).map(|bridge| bridge[0]);
        let mut walk = Vec::new();
        for step in 0..ring.len() {
            let corner = (entry + step) % ring.len();
            walk.push(ring[corner]);
            if exit == Some(corner) {
                walk.append(&mut tail);
                walk.push(ring[corner]);
            }
        }
        // Back to where the ring before this one was left.
        if i > 0 {
            walk.push(ring[entry]);
        }
        tail = walk;
    }
    tail
}

/// The indices of the corners of two rings that are nearest to each other, the first of equals.
fn nearest(a: &[Corner], b: &[Corner]) -> [usize; 2] {
    let distance = |a: &Corner, b: &Corner| {
        let [x, y] = [0, 1].map(|axis| u64::from(a[axis].abs_diff(b[axis])));
        x * x + y * y
    };
    let pairs = (0..a.len()).flat_map(|i| (0..b.len()).map(move |j| [i, j]));
    pairs.min_by_key(|[i, j]| distance(&a[*i], &b[*j])).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The polygon of a drawing: `#` is inside.
    fn of(rows: &[&str]) -> Vec<Corner> {
        let size = [rows[0].len() as u32, rows.len() as u32];
        polygon(size, |x, y| rows[y as usize].as_bytes()[x as usize] == b'#')
    }

    /// The pixels whose centres are inside a polygon, by the even-odd rule.
    fn drawn(polygon: &[Corner], [width, height]: [usize; 2]) -> Vec<String> {
        let edges = || polygon.iter().zip(polygon.iter().cycle().skip(1));
        let is_inside = |x: f64, y: f64| {
            let crossings = edges().filter(|(a, b)| {
                let [ax, ay, bx, by] = [a[0], a[1], b[0], b[1]].map(f64::from);
                (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
            });
            crossings.count() % 2 == 1
        };
        let row = |y: usize| {
            (0..width).map(|x| if is_inside(x as f64 + 0.5, y as f64 + 0.5) { '#' } else { '.' }).collect()
        };
        (0..height).map(row).collect()
    }

    #[test]
    fn a_polygon_goes_along_the_edges_of_pixels_and_only_turns() {
        assert_eq!(of(&["...", ".#.", "..."]), [[1, 1], [2, 1], [2, 2], [1, 2]]);
        assert_eq!(of(&["###", "###"]), [[0, 0], [3, 0], [3, 2], [0, 2]]);
        assert!(of(&["..", ".."]).is_empty());
    }

    #[test]
    fn a_polygon_encloses_its_pixels_and_their_holes() {
        for (rows, filled) in [
            (&["##..", ".##.", "...#"][..], &["##..", ".##.", "...#"][..]),
            // Two diagonals that meet in corners, both ways.
            (&["#..#", ".##.", "#..#"], &["#..#", ".##.", "#..#"]),
            // A ring is filled, and so is what it encloses.
            (&["#####", "#...#", "#.#.#", "#...#", "#####"], &["#####"; 5]),
            // Three parts.
            (&["#....", "#..##", "...##", "#....", "##..#"], &["#....", "#..##", "...##", "#....", "##..#"]),
            (&["#.#.#.#", ".......", "#.#.#.#"], &["#.#.#.#", ".......", "#.#.#.#"]),
        ] {
            let size = [rows[0].len(), rows.len()];
            let polygon = of(rows);
            assert_eq!(drawn(&polygon, size), filled, "{polygon:?}");
        }
    }
}
