//! The classes: id, name, preview colour, defined here only.
//!
//! Shaders receive ids as data and contain no class constants.
//! To add a class: a row in [`ClassId::ALL`] with its constant.

/// Id of a semantic class in the mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ClassId(pub u8);

/// One semantic class.
#[derive(Clone, Copy, Debug)]
pub struct Class {
    /// Its id in the mask.
    pub id: ClassId,
    /// Its name in label files.
    pub name: &'static str,
    /// Its colour in previews, 8-bit sRGB.
    pub preview_rgb: [u8; 3],
    /// Its raw id in a Replicator pipeline (0 is BACKGROUND, 1 UNLABELLED).
    pub replicator_id: u8,
}

impl ClassId {
    /// The ground.
    pub const REGOLITH: Self = Self(0);
    /// Boulders and stones.
    pub const ROCK: Self = Self(1);
    /// Dome and stars.
    pub const SKY: Self = Self(2);
    /// Parts of the rover, from the shaders to the readback. A mask has [`Self::UNLABELLED`] there.
    pub const HARDWARE: Self = Self(3);
    /// The ignore index for training: rocks that do not count, boundaries under an edge policy. Also the clear value, which no draw
    /// leaves in a correct frame.
    pub const UNLABELLED: Self = Self(255);

    /// Every class that a pixel of a correct frame can have, by ascending id.
    pub const ALL: [Class; 3] = [
        Class { id: Self::REGOLITH, name: "regolith", preview_rgb: [170, 140, 110], replicator_id: 4 },
        Class { id: Self::ROCK, name: "rock", preview_rgb: [220, 45, 40], replicator_id: 3 },
        Class { id: Self::SKY, name: "sky", preview_rgb: [70, 120, 205], replicator_id: 2 },
    ];

    /// The class's row, `None` for unlabelled and unknown ids.
    #[must_use]
    pub fn class(self) -> Option<&'static Class> {
        static ALL: [Class; 3] = ClassId::ALL;
        ALL.iter().find(|class| class.id == self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_names_and_colours_are_distinct() {
        for (i, a) in ClassId::ALL.iter().enumerate() {
            assert_ne!(a.id, ClassId::UNLABELLED);
            assert_eq!(a.id.class().map(|class| class.name), Some(a.name));
            for b in &ClassId::ALL[i + 1..] {
                assert!(a.id < b.id && a.name != b.name && a.preview_rgb != b.preview_rgb);
                assert_ne!(a.replicator_id, b.replicator_id);
            }
        }
        assert!(ClassId::UNLABELLED.class().is_none());
    }
}
