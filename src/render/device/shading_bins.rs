//! Shading bins: the samples of a frame, by the pipeline and the relief that shade them.
//!
//! The visibility stage writes one more than the number of a sample's bin to the stencil, 0 where there is no surface; the lighting
//! pass shades each bin with one draw. Bins are numbered in the order in which they are rasterised, near surfaces before those that
//! they may occlude.
//!
//! Where the device does not gain from bins, one draw shades all samples, each by the [`Detail`] of its instance.
//! Must not know: a pass.

/// What can occlude the sun at a surface. The values are those of `SHADOW_SOURCES` in `common/shading.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShadowSources {
    /// Nothing: a surface that faces the sun sees all of it.
    None,
    /// Other ground, by the horizon map.
    Ground,
    /// Rocks, by the shadow atlas.
    Rocks,
    /// Both.
    GroundAndRocks,
}

impl ShadowSources {
    /// Every variant, in the order of its value.
    pub const ALL: [Self; 4] = [Self::None, Self::Ground, Self::Rocks, Self::GroundAndRocks];

    /// Whether rocks are among them.
    #[must_use]
    pub const fn has_rocks(self) -> bool {
        matches!(self, Self::Rocks | Self::GroundAndRocks)
    }
}

/// What lighting adds to a surface below its mesh. The values are those of the DETAIL constants in `common/shading.wgsl` and
/// `lighting_one_draw.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Detail {
    /// Nothing.
    None = 0,
    /// The relief of the ground.
    Relief = 1,
    /// The texture of rocks.
    RockTexture = 2,
    /// Slopes of the ground that the host computed.
    UploadedSlopes = 3,
    /// The surface emits light, and reflects none.
    Emissive = 4,
}

impl Detail {
    /// Bits of `Instance::detail` below the index of its relief.
    pub(crate) const BITS: u32 = 8;

    /// `Instance::detail`, with the slot of its relief uniforms.
    pub(crate) const fn with_relief(self, relief: u32) -> u32 {
        self as u32 | (relief << Self::BITS)
    }
}

/// The pipeline that shades a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightingVariant {
    /// Ground.
    Ground {
        /// What can occlude the sun there.
        sources: ShadowSources,
    },
    /// Rocks.
    Rocks {
        /// What can occlude the sun there.
        sources: ShadowSources,
    },
    /// Dome, sun and stars.
    Sky,
    /// All surfaces, each sample by its instance: for lighting in one draw.
    Any,
}

impl LightingVariant {
    /// The variants that shade any surface, whatever occludes the sun there.
    pub const GENERAL: [Self; 3] = [
        Self::Rocks { sources: ShadowSources::GroundAndRocks },
        Self::Ground { sources: ShadowSources::GroundAndRocks },
        Self::Sky,
    ];
}

/// Number of a bin.
pub(crate) type ShadingBin = u8;

/// The bins of a frame: rocks, ground by relief band, stars, the sun, dome.
#[derive(Clone, Copy, Debug, Default)]
pub struct ShadingBins {
    /// Relief bands of the ground.
    bands: usize,
}

impl ShadingBins {
    /// Bins of a frame whose ground has this many relief bands.
    ///
    /// # Panics
    /// If there are more bins than values of the stencil.
    #[must_use]
    pub fn new(bands: usize) -> Self {
        let bins = Self { bands };
        assert!(bins.dome() < ShadingBin::MAX, "{bands} bands have more bins than the stencil has values");
        bins
    }

    /// Bin of rocks. Those that only the ground can shadow share the bin of both sources.
    #[must_use]
    pub const fn rocks(sources: ShadowSources) -> ShadingBin {
        match sources {
            ShadowSources::Ground | ShadowSources::GroundAndRocks => 0,
            ShadowSources::Rocks => 1,
            ShadowSources::None => 2,
        }
    }

    /// Bin of the ground in a relief band.
    #[must_use]
    pub const fn ground(band: usize, sources: ShadowSources) -> ShadingBin {
        (3 + 4 * band) as ShadingBin + sources as ShadingBin
    }

    /// Maps a bin of the ground to that of the first relief band with the same shadow sources, any other to itself. Where the
    /// G-buffer has slopes, the lighting pass does not evaluate relief, and all bands are shaded by the same pipeline.
    #[must_use]
    #[inline(always)]
    pub const fn merge_bands(self, bin: ShadingBin) -> ShadingBin {
        let from_ground = bin.wrapping_sub(Self::ground(0, ShadowSources::None));
        if from_ground < (4 * self.bands) as ShadingBin {
            Self::ground(0, ShadowSources::None) + (from_ground & 3)
        } else {
            bin
        }
    }

    /// 1 if a bin is of ground of the first relief band that other ground can shade, else 0. The same ground without has the bin before.
    #[must_use]
    #[inline(always)]
    pub const fn is_shaded_by_ground(bin: ShadingBin) -> u8 {
        let sources = bin.wrapping_sub(Self::ground(0, ShadowSources::None));
        if sources < 4 { sources & ShadowSources::Ground as ShadingBin } else { 0 }
    }

    /// Bin of the stars.
    #[must_use]
    pub const fn stars(self) -> ShadingBin {
        (3 + 4 * self.bands) as ShadingBin
    }

    /// Bin of the sun's disc.
    #[must_use]
    pub const fn sun(self) -> ShadingBin {
        self.stars() + 1
    }

    /// Bin of the sky's dome, the last.
    #[must_use]
    pub const fn dome(self) -> ShadingBin {
        self.sun() + 1
    }

    /// Pipeline and relief band of every bin, by number.
    pub fn all(self) -> impl Iterator<Item = (LightingVariant, usize)> {
        let rocks = [ShadowSources::GroundAndRocks, ShadowSources::Rocks, ShadowSources::None]
            .map(|sources| (LightingVariant::Rocks { sources }, 0));
        let ground = |band| ShadowSources::ALL.map(|sources| (LightingVariant::Ground { sources }, band));
        rocks.into_iter().chain((0..self.bands).flat_map(ground)).chain([(LightingVariant::Sky, 0); 3])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_listed_by_number() {
        let bins = ShadingBins::new(4);
        let all: Vec<_> = bins.all().collect();
        for sources in [ShadowSources::None, ShadowSources::Rocks, ShadowSources::GroundAndRocks] {
            assert_eq!(
                all[usize::from(ShadingBins::rocks(sources))],
                (LightingVariant::Rocks { sources }, 0)
            );
        }
        for band in 0..4 {
            for sources in ShadowSources::ALL {
                assert_eq!(
                    all[usize::from(ShadingBins::ground(band, sources))],
                    (LightingVariant::Ground { sources }, band)
                );
            }
        }
        for (bin, (variant, band)) in (0..).zip(&all) {
            let merged = bins.merge_bands(bin);
            assert_eq!(all[usize::from(merged)], (*variant, 0), "{variant:?} of band {band}");
            assert!(merged == bin || matches!(variant, LightingVariant::Ground { .. }) && *band > 0);
        }
        for (bin, (variant, _)) in (0..ShadingBins::ground(1, ShadowSources::None)).zip(&all) {
            let is_shaded = ShadingBins::is_shaded_by_ground(bin) == 1;
            let LightingVariant::Ground { sources } = *variant else {
                assert!(!is_shaded, "{variant:?}");
                continue;
            };
            assert_eq!(is_shaded, matches!(sources, ShadowSources::Ground | ShadowSources::GroundAndRocks));
            if is_shaded {
                let without = if sources.has_rocks() { ShadowSources::Rocks } else { ShadowSources::None };
                assert_eq!(bin - 1, ShadingBins::ground(0, without));
            }
        }
        for bin in [bins.stars(), bins.sun()] {
            assert_eq!(all[usize::from(bin)], (LightingVariant::Sky, 0));
        }
        assert_eq!(usize::from(bins.dome()), all.len() - 1);
    }
}
