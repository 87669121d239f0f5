//! The hash of points of an integer lattice.
//!
//! Must not know: what is drawn from it.

/// Factor of the x coordinate in [`lattice_hash`].
pub(super) const HASH_X: u32 = 0x8da6_b343;
/// Factor of the y coordinate.
pub(super) const HASH_Y: u32 = 0xd816_3841;
/// Factor of the z coordinate.
pub(super) const HASH_Z: u32 = 0xcb1a_b31f;

/// Hash of a lattice point: a linear form in the coordinates (odd constants, from Teschner et al. 2003,
/// "Optimized Spatial Hashing", made odd 32-bit), then the 32-bit finaliser "lowbias32" of Chris Wellons
/// (2018, hash-prospector).
#[must_use]
#[inline(always)]
pub const fn lattice_hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let (x, y) = ((x as u32).wrapping_mul(HASH_X), (y as u32).wrapping_mul(HASH_Y));
    last_mixed(first_mixed(x ^ y ^ (z as u32).wrapping_mul(HASH_Z) ^ seed))
}

/// The finaliser's first step. It is linear over exclusive or: the step of `a ^ b` is the exclusive or of their steps, so
/// that each coordinate's part is computed once.
#[inline(always)]
pub(super) const fn first_mixed(h: u32) -> u32 {
    h ^ (h >> 16)
}

/// The rest of the finaliser.
#[inline(always)]
pub(super) const fn last_mixed(mut h: u32) -> u32 {
    h = h.wrapping_mul(0x7feb_352d);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computed by hand-written Python integers from the definition in the docs, not by this code.
    #[test]
    fn lattice_hash_has_its_known_values() {
        for (x, y, z, seed, expected) in KNOWN_HASHES {
            assert_eq!(lattice_hash(x, y, z, seed), expected, "({x}, {y}, {z}) seed {seed}");
        }
    }
    const KNOWN_HASHES: [(i32, i32, i32, u32, u32); 4] = [
        (0, 0, 0, 0, 0x00000000),
        (1, 2, 3, 42, 0x70b24687),
        (-5, 7, -11, 1, 0xe55ecafb),
        (1000, -2000, 3000, 0xdeadbeef, 0xc4f60271),
    ];
}
