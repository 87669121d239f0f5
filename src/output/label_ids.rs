//! Which numbers stand for the classes in a mask.
//!
//! Must not know: how a mask is encoded.

use serde_json::{Map, Value, json};

use crate::class::ClassId;

/// The numbering of the classes in a mask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LabelIds {
    /// The ids of [`ClassId`].
    #[default]
    Canonical,
    /// The raw ids that a Replicator pipeline assigns: 0 BACKGROUND, 1 UNLABELLED, then the classes.
    Replicator,
}

impl LabelIds {
    /// The value of `--label-ids` that selects it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Canonical => "canonical",
            Self::Replicator => "replicator",
        }
    }

    /// The numbering that a value of `--label-ids` selects.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Canonical, Self::Replicator].into_iter().find(|ids| ids.name() == name)
    }

    /// The numbering of a dataset according to its manifest; canonical if the manifest does not say.
    #[must_use]
    pub fn of_manifest(manifest: &Map<String, Value>) -> Self {
        let name = manifest.get("label_ids").and_then(Value::as_str);
        name.and_then(Self::from_name).unwrap_or_default()
    }

    /// The id that the mask carries for a class id. Unlabelled becomes 255 (canonical) or 1 (Replicator).
    #[must_use]
    pub fn mask_id(self, id: u8) -> u8 {
        match (self, ClassId(id).class()) {
            (Self::Canonical, _) => id,
            (Self::Replicator, Some(class)) => class.replicator_id,
            (Self::Replicator, None) => 1,
        }
    }

    /// Every id that can occur in a label file, with its name, in ascending order of id.
    #[must_use]
    pub fn names(self) -> Vec<(u8, &'static str)> {
        let mut rows: Vec<(u8, &'static str)> =
            ClassId::ALL.iter().map(|class| (self.mask_id(class.id.0), class.name)).collect();
        if self == Self::Replicator {
            rows.extend([(0, "BACKGROUND"), (1, "UNLABELLED")]);
        }
        rows.sort_unstable();
        rows
    }

    /// Content of the label file, as in `{"1": {"class": "rock"}}`.
    #[must_use]
    pub fn labels(self) -> Value {
        let rows = self.names().into_iter();
        rows.map(|(id, name)| (id.to_string(), json!({ "class": name }))).collect::<Map<_, _>>().into()
    }

    /// The same as Hugging Face's `id2label`, as in `{"1": "rock"}`.
    #[must_use]
    pub fn id2label(self) -> Value {
        self.names().into_iter().map(|(id, name)| (id.to_string(), name.into())).collect::<Map<_, _>>().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn label_files_name_every_id() {
        let text = |ids: LabelIds| ids.labels().to_string();
        assert_eq!(
            text(LabelIds::Canonical),
            r#"{"0":{"class":"regolith"},"1":{"class":"rock"},"2":{"class":"sky"}}"#
        );
        assert_eq!(
            text(LabelIds::Replicator),
            r#"{"0":{"class":"BACKGROUND"},"1":{"class":"UNLABELLED"},"2":{"class":"sky"},"3":{"class":"rock"},"4":{"class":"regolith"}}"#
        );
    }
}
