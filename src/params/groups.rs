//! Groups of knobs, by what a user wants to change.
//!
//! Must not know: what a knob does.
//! To add a section of knobs: its name in a row of [`GROUPS`].

/// Title of each group, what it changes, and its sections of knobs.
pub const GROUPS: [(&str, &str, &[&str]); 7] = [
    ("Kind of scene", "the simple reference stage or the realistic surface", &["stage"]),
    (
        "Light",
        "where the sun stands, how bright it is, and what surfaces reflect",
        &["sun", "sky", "photometry", "hapke"],
    ),
    ("Ground", "hills, craters, soil", &["terrain", "relief", "wall", "craters", "regolith", "grains"]),
    ("Rocks", "how many, how large, how bright", &["rocks"]),
    ("Camera", "where it stands and looks, its lens, its sensor", &["camera", "sensor", "flare"]),
    ("Rover", "its shadow, its tracks, its parts in view", &["rover", "tracks"]),
    ("Labels", "which rocks and craters count", &["label"]),
];

/// Position of a section's group in [`GROUPS`]; their number for a section of none.
#[must_use]
pub fn group_of(section: &str) -> usize {
    GROUPS.iter().position(|(.., sections)| sections.contains(&section)).unwrap_or(GROUPS.len())
}
