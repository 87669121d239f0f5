//! By which draw of the lighting pass a sample is lit.
//!
//! Samples that are lit alike are a group. The visibility pass draws groups in their order, near things before what they may
//! cover, and leaves one more than the group's number in the stencil.

use crate::render::select::caster_grid::ShadowSources;

/// By which program samples are lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightingVariant {
    /// Ground that these things can shade.
    Ground {
        /// What can shade it.
        shades: ShadowSources,
    },
    /// Rocks that these things can shade.
    Rocks {
        /// What can shade them.
        shades: ShadowSources,
    },
    /// Dome and stars.
    Sky,
}

impl LightingVariant {
    /// Those that light anything, whatever can shade it.
    pub const BY_ANYTHING: [Self; 3] = [
        Self::Rocks { shades: ShadowSources::GroundAndRocks },
        Self::Ground { shades: ShadowSources::GroundAndRocks },
        Self::Sky,
    ];
}

/// A group by its number.
pub type ShadingBin = u8;

/// The groups of a picture: rocks, ground, stars, dome.
#[derive(Clone, Copy, Debug, Default)]
pub struct ShadingBins {
    /// Bands of the ground, which have a relief each.
    bands: usize,
}

impl ShadingBins {
    /// Those of a picture with so many bands of ground.
    ///
    /// # Panics
    /// If the stencil cannot tell them apart.
    #[must_use]
    pub fn new(bands: usize) -> Self {
        let groups = Self { bands };
        assert!(groups.dome() < ShadingBin::MAX, "the stencil tells {bands} bands apart");
        groups
    }

    /// Rocks that these things can shade.
    #[must_use]
    pub const fn rocks(shades: ShadowSources) -> ShadingBin {
        match shades {
            ShadowSources::Ground | ShadowSources::GroundAndRocks => 0,
            ShadowSources::Rocks => 1,
            ShadowSources::None => 2,
        }
    }

    /// Ground of a band that these things can shade.
    #[must_use]
    pub const fn ground(band: usize, shades: ShadowSources) -> ShadingBin {
        (3 + 4 * band) as ShadingBin + shades as ShadingBin
    }

    /// The group that takes the place of one of the ground, where slopes are given and all bands are lit alike: that of the first
    /// band. Any other stays.
    #[must_use]
    #[inline(always)]
    pub const fn merge_bands(self, group: ShadingBin) -> ShadingBin {
        let of_ground = group.wrapping_sub(Self::ground(0, ShadowSources::None));
        if of_ground < (4 * self.bands) as ShadingBin {
            Self::ground(0, ShadowSources::None) + (of_ground & 3)
        } else {
            group
        }
    }

    /// Stars.
    #[must_use]
    pub const fn stars(self) -> ShadingBin {
        (3 + 4 * self.bands) as ShadingBin
    }

    /// The dome.
    #[must_use]
    pub const fn dome(self) -> ShadingBin {
        self.stars() + 1
    }

    /// By what program each is lit, and which band it is of.
    pub fn all(self) -> impl Iterator<Item = (LightingVariant, usize)> {
        let rocks = [ShadowSources::GroundAndRocks, ShadowSources::Rocks, ShadowSources::None]
            .map(|shades| (LightingVariant::Rocks { shades }, 0));
        let ground = |band| ShadowSources::ALL.map(|shades| (LightingVariant::Ground { shades }, band));
        rocks.into_iter().chain((0..self.bands).flat_map(ground)).chain([(LightingVariant::Sky, 0); 2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_stand_in_the_order_of_their_numbers() {
        let groups = ShadingBins::new(4);
        let all: Vec<_> = groups.all().collect();
        for shades in [ShadowSources::None, ShadowSources::Rocks, ShadowSources::GroundAndRocks] {
            assert_eq!(all[usize::from(ShadingBins::rocks(shades))], (LightingVariant::Rocks { shades }, 0));
        }
        for band in 0..4 {
            for shades in ShadowSources::ALL {
                assert_eq!(
                    all[usize::from(ShadingBins::ground(band, shades))],
                    (LightingVariant::Ground { shades }, band)
                );
            }
        }
        for (group, (lit, band)) in (0..).zip(&all) {
            let merged = groups.merge_bands(group);
            assert_eq!(all[usize::from(merged)], (*lit, 0), "{lit:?} of band {band}");
            assert!(merged == group || matches!(lit, LightingVariant::Ground { .. }) && *band > 0);
        }
        assert_eq!(all[usize::from(groups.stars())], (LightingVariant::Sky, 0));
        assert_eq!(usize::from(groups.dome()), all.len() - 1);
    }
}
