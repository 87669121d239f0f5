//! What was checked and what was found.
//!
//! Must not know: how anything is checked.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

/// Names of the checks: keys of the JSON report, which scripts rely on.
pub(super) mod name {
    pub(in crate::dataset::verify) const LOG: &str = "books";
    pub(in crate::dataset::verify) const RECORDS: &str = "records";
    pub(in crate::dataset::verify) const FILES: &str = "files";
    pub(in crate::dataset::verify) const HASHES: &str = "hashes";
    pub(in crate::dataset::verify) const IMAGES: &str = "pictures";
    pub(in crate::dataset::verify) const MASKS: &str = "masks";
    pub(in crate::dataset::verify) const LABELS: &str = "labels";
    pub(in crate::dataset::verify) const STATISTICS: &str = "statistics";
    pub(in crate::dataset::verify) const DIGEST: &str = "digest";
    pub(in crate::dataset::verify) const RENDERING: &str = "rendering";
    pub(in crate::dataset::verify) const DEPTH: &str = "depth";
}

/// Name and description of every check, in the order of the table.
pub const CHECKS: [(&str, &str); 11] = [
    (name::LOG, "manifest.json, frames.jsonl and index files agree, frames are contiguous, seeds are right"),
    (name::RECORDS, "every key of a line follows from seed and configuration, or from the frame's files"),
    (name::FILES, "every file exists, and there is nothing else in the folder"),
    (name::HASHES, "file content is unchanged"),
    (name::IMAGES, "images and arrays decode and have the right size and type"),
    (name::MASKS, "mask ids are those of the classes, class fractions are as recorded"),
    (name::LABELS, "label files name the ids of the masks"),
    (name::STATISTICS, "image brightness is as recorded"),
    (name::DIGEST, "the digest in manifest.json is that of all lines"),
    (name::RENDERING, "a sample of frames, rendered again, is the same in every output"),
    (name::DEPTH, "depth of that sample, unprojected by K and pose, lies on the surface"),
];

/// Problems of a check that are listed; further ones are only counted, so that a dataset that is wrong throughout needs no more
/// memory than another.
const MAX_LISTED: u64 = 10_000;

/// What a problem is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// The dataset as a whole, not one frame.
    Dataset,
    /// The line of the frame of this index, or what it says.
    Line(u64),
    /// A file of the frame of this index.
    File(u64),
}

impl Subject {
    /// The frame; `None` if it is not about one.
    #[must_use]
    pub const fn index(self) -> Option<u64> {
        match self {
            Self::Dataset => None,
            Self::Line(index) | Self::File(index) => Some(index),
        }
    }
}

/// As the index of the frame, or null.
impl serde::Serialize for Subject {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.index().serialize(serializer)
    }
}

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Problem {
    /// Name of the check.
    pub check: &'static str,
    /// What it is about.
    #[serde(rename = "index")]
    pub subject: Subject,
    /// The file, the value found and the value expected.
    pub found: String,
}

/// The result of all checks.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Number of items that each check examined, by name; absent if the check was not made.
    pub looked_at: BTreeMap<&'static str, u64>,
    /// What is wrong, the first of each check: [`Self::count`] has all.
    pub problems: Vec<Problem>,
    /// Number of problems that each check found, by name.
    wrong: BTreeMap<&'static str, u64>,
    /// Number of frames.
    pub frames: u64,
}

impl Report {
    /// The report of one frame.
    pub(super) fn of_frame() -> Self {
        Self { frames: 1, ..Self::default() }
    }

    /// Counts an item that a check examined.
    pub(super) fn look(&mut self, check: &'static str) {
        *self.looked_at.entry(check).or_default() += 1;
    }

    pub(super) fn problem(&mut self, check: &'static str, subject: Subject, found: String) {
        self.list(Problem { check, subject, found });
        *self.wrong.entry(check).or_default() += 1;
    }

    /// Lists a problem, unless its check has many already.
    fn list(&mut self, problem: Problem) {
        if self.wrong_in(problem.check) < MAX_LISTED {
            self.problems.push(problem);
        }
    }

    /// Number of problems that a check found.
    #[must_use]
    pub fn wrong_in(&self, check: &str) -> u64 {
        self.wrong.get(check).copied().unwrap_or_default()
    }

    /// Number of all problems, also those that are not listed.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.wrong.values().sum()
    }

    /// Whether a problem is about a file of a frame: not about its line, nor about the dataset as a whole.
    #[must_use]
    pub fn is_frame_file_damaged(&self) -> bool {
        self.problems.iter().any(|problem| matches!(problem.subject, Subject::File(_)))
    }

    /// Counts an item, and adds a problem if it is not good.
    pub(super) fn expect(
        &mut self,
        check: &'static str,
        subject: Subject,
        is_good: bool,
        found: impl FnOnce() -> String,
    ) {
        self.look(check);
        if !is_good {
            self.problem(check, subject, found());
        }
    }

    /// Adds the results of other frames.
    pub(super) fn add(&mut self, other: Self) {
        for (check, count) in other.looked_at {
            *self.looked_at.entry(check).or_default() += count;
        }
        other.problems.into_iter().for_each(|problem| self.list(problem));
        for (check, count) in other.wrong {
            *self.wrong.entry(check).or_default() += count;
        }
        self.frames += other.frames;
    }

    /// The report as JSON.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let checks: Map<String, Value> = CHECKS
            .iter()
            .map(|(name, what)| {
                let looked_at = self.looked_at.get(name);
                let row = json!({ "what": what, "looked_at": looked_at, "wrong": self.wrong_in(name) });
                ((*name).to_owned(), row)
            })
            .collect();
        json!({ "good": self.problems.is_empty(), "frames": self.frames, "checks": checks, "problems": self.problems })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_problems_is_counted_and_hides_no_other_check() {
        let mut report = Report::default();
        for frame in 0..3 * MAX_LISTED {
            let mut part = Report::of_frame();
            part.expect(name::HASHES, Subject::File(frame), false, || "changed".to_owned());
            report.add(part);
        }
        report.problem(name::LOG, Subject::Dataset, "status".to_owned());
        assert_eq!(report.count(), 3 * MAX_LISTED + 1);
        assert!(report.problems.len() as u64 <= MAX_LISTED + 1);
        assert_eq!(report.problems.last().map(|problem| problem.check), Some(name::LOG));
        let json = report.to_json();
        assert_eq!(json["checks"][name::HASHES]["wrong"], 3 * MAX_LISTED);
        assert_eq!((&json["good"], &json["frames"]), (&false.into(), &(3 * MAX_LISTED).into()));
    }

    #[test]
    fn only_a_problem_of_a_frames_file_is_one() {
        let report = |subject| {
            let mut report = Report::of_frame();
            report.problem(name::RECORDS, subject, "frames.jsonl.png: wrong".to_owned());
            report
        };
        let damaged = [Subject::Dataset, Subject::Line(3), Subject::File(3)].map(report);
        assert_eq!(damaged.each_ref().map(Report::is_frame_file_damaged), [false, false, true]);
        let indices = damaged.each_ref().map(|report| report.to_json()["problems"][0]["index"].clone());
        assert_eq!(indices, [Value::Null, 3.into(), 3.into()]);
    }
}
