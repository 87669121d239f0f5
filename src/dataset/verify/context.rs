//! What the manifest says about all frames.
//!
//! Must not know: the checks.

use std::path::Path;

use serde_json::{Map, Value};

use super::templates::{self, Template};
use crate::dataset::gate::{Gate, no_dataset, read_manifest};
use crate::dataset::plan::Plan;
use crate::error::{Error, Result};
use crate::output::disk;

/// How the version that made a dataset is related to this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Version {
    /// This version.
    Same,
    /// Another patch of the same minor version: the same scenes and pixels, perhaps other bytes.
    SameScenes,
    /// Any other, which makes other scenes of the same seeds.
    Other,
}

impl Version {
    fn of(manifest: &Map<String, Value>) -> Self {
        let own = env!("CARGO_PKG_VERSION");
        let recorded = manifest.get("version").and_then(Value::as_str).unwrap_or_default();
        let minor = |version: &str| version.rsplit_once('.').map(|(minor, _)| minor.to_owned());
        if recorded == own {
            Self::Same
        } else if minor(recorded) == minor(own) {
            Self::SameScenes
        } else {
            Self::Other
        }
    }
}

/// What the manifest says about all frames, and where they are.
pub(super) struct Context<'a> {
    pub(super) folder: &'a Path,
    pub(super) manifest: &'a Map<String, Value>,
    pub(super) plan: Plan,
    pub(super) gate: Gate,
    pub(super) version: Version,
    /// One for each file of the outputs.
    pub(super) templates: Vec<Template>,
}

impl<'a> Context<'a> {
    /// The context of a dataset with this manifest.
    ///
    /// # Errors
    /// [`Error::CheckFailed`] if a key of the manifest from which others are derived is missing or invalid.
    pub(super) fn new(folder: &'a Path, manifest: &'a Map<String, Value>) -> Result<Self> {
        let version = Version::of(manifest);
        let plan = match Plan::of_manifest(manifest) {
            // Other versions have other knobs.
            Err(_) if version == Version::Other => {
                let mut without_knobs = manifest.clone();
                without_knobs.insert("config".to_owned(), Map::new().into());
                Plan::of_manifest(&without_knobs)
            }
            plan => plan,
        };
        let plan = plan.map_err(|error| match error {
            Error::CheckFailed(found) => Error::CheckFailed(format!("{}: {found}", folder.display())),
            other => other,
        })?;
        let gate = Gate::of_manifest(manifest)?;
        Ok(Self { folder, manifest, version, templates: templates::of(&plan)?, plan, gate })
    }

    /// What identifies the dataset, derived from the parts of the manifest that nothing else follows from.
    pub(super) fn identity(&self) -> Map<String, Value> {
        let mut identity = self.plan.identity();
        if let (Some(version), true) = (self.manifest.get("version"), self.version == Version::SameScenes) {
            identity.insert("version".to_owned(), version.clone());
        }
        identity
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
        if !has_shards {
            return Err(no_dataset(folder));
        }
        let message =
            "its shards are not merged yet; run `regolith-render dataset --merge --out` with this folder";
        return Err(Error::Dataset { path: folder.to_owned(), message: message.to_owned() });
    }
    read_manifest(&path)
}
