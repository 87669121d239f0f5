//! Demosaicing with gradient correction (Malvar, He and Cutler 2004, "High-quality linear interpolation for demosaicing of
//! Bayer-patterned color images", figure 2).
//! Must not know: what a reading is made of.

/// Pixels beyond the border that a row has on each side, and rows that are needed above and below.
pub(super) const REACH: usize = 2;

/// The index of a row or column of a line of `len` that may lie beyond its ends: mirrored about the first and the last, so that its
/// filter is the same.
#[inline]
pub(super) fn mirrored(index: isize, len: usize) -> usize {
    let last = len as isize - 1;
    let inside = if index < 0 {
        -index
    } else if index > last {
        2 * last - index
    } else {
        index
    };
    inside.clamp(0, last) as usize
}

/// The colours of a row of pixels with filters RGGB: red, green and blue of the whole row, one after another. `rows` are the readings
/// of the row between two above and two below, each with [`REACH`] more on both sides.
// Inlined into `dispatch!`, so that it is compiled for each SIMD level.
#[inline(always)]
pub(super) fn demosaic_row(rows: [&[f32]; 5], is_odd_row: bool, colours: [&mut [f32]; 3]) {
    let [red, green, blue] = colours;
    let width = red.len();
    let [above2, above, row, below, below2] = rows.map(|row| &row[..width + 2 * REACH]);
    let (green, blue) = (&mut green[..width], &mut blue[..width]);
    for x in 0..width {
        let at = x + REACH;
        let own = row[at];
        let (beside, across) = (row[at - 1] + row[at + 1], above[at] + below[at]);
        let (beside2, across2) = (row[at - 2] + row[at + 2], above2[at] + below2[at]);
        let diagonal = above[at - 1] + above[at + 1] + below[at - 1] + below[at + 1];
        let cross = 0.125 * (4.0 * own + 2.0 * (beside + across) - (beside2 + across2));
        let horizontal = 0.125 * (5.0 * own + 4.0 * beside - diagonal - beside2 + 0.5 * across2);
        let vertical = 0.125 * (5.0 * own + 4.0 * across - diagonal - across2 + 0.5 * beside2);
        let opposite = 0.125 * (6.0 * own + 2.0 * diagonal - 1.5 * (beside2 + across2));
        let is_odd = x & 1 == 1;
        let is_green = is_odd != is_odd_row;
        // The channel of this row that is not green, and the other.
        let same = if is_green { horizontal } else { own };
        let other = if is_green { vertical } else { opposite };
        green[x] = if is_green { own } else { cross };
        red[x] = if is_odd_row { other } else { same };
        blue[x] = if is_odd_row { same } else { other };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All colours of an image from its readings.
    fn demosaiced(readings: impl Fn(usize, usize) -> f32, width: usize, height: usize) -> Vec<[f32; 3]> {
        let reach = REACH as isize;
        let padded: Vec<Vec<f32>> = (-reach..height as isize + reach)
            .map(|y| {
                let columns = -reach..width as isize + reach;
                columns.map(|x| readings(mirrored(x, width), mirrored(y, height))).collect()
            })
            .collect();
        let mut colours = Vec::new();
        for y in 0..height {
            let [mut red, mut green, mut blue] = [0, 1, 2].map(|_| vec![0.0; width]);
            let rows = [0, 1, 2, 3, 4].map(|row| &padded[y + row][..]);
            demosaic_row(rows, y % 2 == 1, [&mut red, &mut green, &mut blue]);
            colours.extend((0..width).map(|x| [red[x], green[x], blue[x]]));
        }
        colours
    }

    /// Each pixel has its own channel, and an even colour is found everywhere.
    #[test]
    fn even_colours_are_found_to_the_border() {
        let colour = [0.4, 0.25, 0.1];
        for (width, height) in [(8, 6), (7, 5), (3, 4)] {
            let found = demosaiced(|x, y| colour[x % 2 + y % 2], width, height);
            for rgb in found {
                assert!(rgb.iter().zip(colour).all(|(a, b)| (a - b).abs() < 1e-6), "{rgb:?}");
            }
        }
    }

    /// A grey gradient in any direction is found without colour, which its equations promise.
    #[test]
    fn grey_gradients_have_no_colour() {
        let grey = |x: usize, y: usize| 0.2 + 0.01 * x as f32 + 0.007 * y as f32;
        let found = demosaiced(grey, 12, 10);
        for y in 2..8 {
            for x in 2..10 {
                let rgb = found[y * 12 + x];
                assert!(rgb.iter().all(|value| (value - grey(x, y)).abs() < 1e-6), "{x}, {y}: {rgb:?}");
            }
        }
    }
}
