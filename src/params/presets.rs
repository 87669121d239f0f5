//! The presets that ship with the program.
//!
//! Must not know: what a knob does.
//! To add a preset: a file in `assets/presets` and its row in [`presets`].

macro_rules! preset_files {
    ($($name:literal),*) => {
        [$(($name, include_str!(concat!("../../assets/presets/", $name, ".toml")))),*]
    };
}

/// Name and TOML text of every preset; the text starts with a comment that describes it.
#[must_use]
pub const fn presets() -> [(&'static str, &'static str); 20] {
    preset_files![
        "reference",
        "train_dr",
        "train_nodr",
        "train_full",
        "test_photoreal",
        "surface_train_dr",
        "surface_train_nodr",
        "surface_train_full",
        "surface_test_photoreal",
        "surface_rover",
        "navcam",
        "pcam",
        "hazcam",
        "sun_equatorial",
        "sun_mid_latitude",
        "sun_polar",
        "camera_hasselblad",
        "camera_navcam",
        "camera_pcam",
        "camera_colour"
    ]
}

/// One-line description of a preset: the comment that its text starts with.
#[must_use]
pub fn preset_description(name: &str) -> Option<&'static str> {
    let (_, text) = presets().into_iter().find(|(preset, _)| *preset == name)?;
    text.lines().next()?.strip_prefix("# ")
}
