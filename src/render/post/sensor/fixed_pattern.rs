//! The fixed pattern of the sensor: random numbers of each pixel that no frame changes, and so are drawn once.
//! Must not know: a frame.

use std::sync::{Arc, Mutex, PoisonError};

use super::noise::{normal, purpose};

/// Seed of the fixed pattern.
pub(super) const FIXED_PATTERN_SEED: u32 = 0x5e25_0a11;
/// Sizes whose patterns are kept.
const MAX_PATTERNS: usize = 2;

/// Standard normal numbers of each pixel, row by row: for PRNU, for DSNU.
pub(super) type FixedPattern = Arc<Vec<[f64; 2]>>;

static PATTERNS: Mutex<Vec<([usize; 2], FixedPattern)>> = Mutex::new(Vec::new());

/// The pattern of a sensor with this many columns and rows.
pub(super) fn fixed_pattern(size @ [width, height]: [usize; 2]) -> FixedPattern {
    let mut patterns = PATTERNS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, pattern)) = patterns.iter().find(|(known, _)| *known == size) {
        return Arc::clone(pattern);
    }
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| of_pixel(x, y)));
    let pattern: FixedPattern = Arc::new(pixels.collect());
    if patterns.len() == MAX_PATTERNS {
        patterns.remove(0);
    }
    patterns.push((size, Arc::clone(&pattern)));
    pattern
}

/// The numbers of a pixel.
pub(super) fn of_pixel(x: usize, y: usize) -> [f64; 2] {
    [purpose::PRNU, purpose::DSNU].map(|purpose| normal(x, y, purpose, FIXED_PATTERN_SEED))
}
