//! Further label sets: names and colours that other datasets use.

/// Id, name and colour of each of five classes: the first three as in the mask; the colours are those of the LuSNAR
/// dataset.
pub(super) const FIVE_CLASSES: [(u8, &str, [u8; 3]); 5] = [
    (0, "regolith", [0xbb, 0x46, 0x9c]),
    (1, "rock", [0xe8, 0xfa, 0x50]),
    (2, "sky", [0x22, 0xc9, 0xf8]),
    (3, "crater", [0x78, 0x00, 0xc8]),
    (4, "mountain", [0xad, 0x45, 0x1f]),
];

/// Rocks of at least this diameter are "large" in [`ROCK_SIZE_CLASSES`], metres. The dataset that the colours come from
/// states no threshold; a rover drives around rocks of half a metre.
pub(super) const LARGE_ROCK_M: f32 = 0.5;

/// Name and colour of each class when rocks are divided by size, as in the Artificial Lunar Landscape dataset (Pessia
/// and Ishigami). The part before the comma, or the whole name, is the class in the mask.
pub(super) const ROCK_SIZE_CLASSES: [(&str, [u8; 3]); 5] = [
    ("regolith", [0, 0, 0]),
    ("rock,small", [0, 255, 0]),
    ("rock,large", [0, 0, 255]),
    ("sky", [255, 0, 0]),
    ("unlabelled", [255, 255, 255]),
];
