//! What the manifest says about all frames.
//!
//! Must not know: the checks.

use std::path::Path;

use serde_json::{Map, Value};

use crate::dataset::manifest;
use crate::dataset::plan::Range;
use crate::error::{Error, Result};
use crate::output::edges::EdgePolicy;
use crate::output::layout::{self, Layout};
use crate::output::{LabelIds, disk};
use crate::params::config::Config;
use crate::render::RenderSettings;

/// What the manifest says about all frames, and where they are.
pub(super) struct Context<'a> {
    pub(super) folder: &'a Path,
    pub(super) layout: &'static dyn Layout,
    pub(super) base_seed: u64,
    pub(super) range: Range,
    pub(super) settings: RenderSettings,
    pub(super) edges: EdgePolicy,
    pub(super) label_ids: LabelIds,
    pub(super) config: Config,
}

impl<'a> Context<'a> {
    /// The context of a dataset with this manifest.
    ///
    /// # Errors
    /// [`Error::CheckFailed`] if the manifest lacks something.
    pub(super) fn new(folder: &'a Path, manifest: &Map<String, Value>) -> Result<Self> {
        Self::from_manifest(folder, manifest).ok_or_else(|| {
            Error::CheckFailed(format!(
                "{}: base seed, range, size, samples, format, edges, label ids or configuration is missing or invalid; \
                 delete the file and run the dataset's command with --force, which writes it again",
                folder.join("manifest.json").display()
            ))
        })
    }

    fn from_manifest(folder: &'a Path, manifest: &Map<String, Value>) -> Option<Self> {
        let number = |key: &str| manifest.get(key)?.as_u64();
        let text = |key: &str| manifest.get(key)?.as_str();
        let size = manifest.get("size")?.as_array()?;
        let side = |i: usize| u32::try_from(size.get(i)?.as_u64()?).ok();
        let layout = layout::find(text("format")?).ok()?.1;
        let recorded = LabelIds::from_name(text("label_ids")?)?;
        let label_ids = if layout.has_fixed_ids() { LabelIds::default() } else { recorded };
        let mut config = Config::new();
        config.apply_json(manifest.get("config")?.as_object()?, "manifest.json").ok()?;
        Some(Self {
            folder,
            layout,
            base_seed: number("base_seed")?,
            range: Range { start: number("start")?, count: number("count")? },
            settings: RenderSettings::new([side(0)?, side(1)?], u32::try_from(number("samples")?).ok()?)
                .ok()?,
            edges: text("edges")?.parse().ok()?,
            label_ids,
            config,
        })
    }
}

/// Reads the manifest of a dataset.
///
/// # Errors
/// [`Error::Dataset`] if there is none, [`Error::CheckFailed`] if it is not JSON.
pub(super) fn open(folder: &Path) -> Result<Map<String, Value>> {
    let path = folder.join("manifest.json");
    if !path.is_file() {
        let has_shards =
            folder.is_dir() && disk::names(folder)?.iter().any(|name| name.starts_with("manifest-"));
        let message = if has_shards {
            "its shards are not merged yet; run `regolith-render dataset --merge --out` with this folder"
        } else {
            "not a dataset: it has no manifest.json"
        };
        return Err(Error::Dataset { path: folder.to_owned(), message: message.to_owned() });
    }
    manifest::read(&path)
}
