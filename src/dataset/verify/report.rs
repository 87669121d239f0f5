//! What was checked and what was found.
//!
//! Must not know: how anything is checked.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

/// Name and description of every check, in the order of the table. The names are keys of the JSON report.
pub const CHECKS: [(&str, &str); 10] = [
    ("books", "manifest.json and frames.jsonl agree, frames are contiguous, seeds are right"),
    ("records", "knobs, camera and sun follow from seed and configuration"),
    ("files", "every file exists, and there are no files of other frames"),
    ("hashes", "file content is unchanged"),
    ("pictures", "images decode and have the right size and type"),
    ("masks", "mask ids are those of the classes, class fractions are as recorded"),
    ("labels", "label files name the ids of the masks"),
    ("statistics", "image brightness is as recorded"),
    ("rendering", "a sample of frames, rendered again, is the same"),
    ("depth", "depth of that sample, unprojected by K and pose, lies on the surface"),
];

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Problem {
    /// Name of the check.
    pub check: &'static str,
    /// The frame; `None` if the problem is not one frame's.
    pub index: Option<u64>,
    /// The file, the value found and the value expected.
    pub found: String,
}

/// The result of all checks.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Number of items that each check examined, by name; absent if the check was not made.
    pub looked_at: BTreeMap<&'static str, u64>,
    /// Everything that is wrong.
    pub problems: Vec<Problem>,
    /// Number of frames.
    pub frames: u64,
}

impl Report {
    /// Counts an item that a check examined.
    pub(super) fn look(&mut self, check: &'static str) {
        *self.looked_at.entry(check).or_default() += 1;
    }

    pub(super) fn problem(&mut self, check: &'static str, index: Option<u64>, found: String) {
        self.problems.push(Problem { check, index, found });
    }

    /// Counts an item, and adds a problem if it is not good.
    pub(super) fn expect(
        &mut self,
        check: &'static str,
        index: Option<u64>,
        is_good: bool,
        found: impl FnOnce() -> String,
    ) {
        self.look(check);
        if !is_good {
            self.problem(check, index, found());
        }
    }

    /// Adds the results of other frames.
    pub(super) fn add(&mut self, other: Self) {
        for (check, count) in other.looked_at {
            *self.looked_at.entry(check).or_default() += count;
        }
        self.problems.extend(other.problems);
        self.frames += other.frames;
    }

    /// The report as JSON.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let checks: Map<String, Value> = CHECKS
            .iter()
            .map(|(name, what)| {
                let wrong = self.problems.iter().filter(|problem| problem.check == *name).count();
                let row = json!({ "what": what, "looked_at": self.looked_at.get(name), "wrong": wrong });
                ((*name).to_owned(), row)
            })
            .collect();
        json!({ "good": self.problems.is_empty(), "frames": self.frames, "checks": checks, "problems": self.problems })
    }
}
