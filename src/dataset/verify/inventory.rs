//! What is in a dataset's folder, against the paths that it must have.
//!
//! Must not know: what files contain.

use std::collections::{BTreeSet, HashSet};
use std::path::Path;

use twox_hash::XxHash3_128;

use super::context::Context;
use super::report::{Report, Subject, name};
use super::templates::ExpectedFrame;
use crate::error::Result;
use crate::output::disk;
use crate::output::disk::own_name::{lock_name, temporary_tag};
use crate::output::layout::FrameLine;

/// The expected folders, and the number of expected files that exist: paths of all files may be too many for memory.
#[derive(Debug, Default)]
pub(super) struct Inventory {
    folders: BTreeSet<String>,
    files: u64,
}

impl Inventory {
    /// Adds an expected file.
    pub(super) fn add(&mut self, context: &Context<'_>, path: &str) {
        for (end, _) in path.match_indices('/') {
            if !self.folders.contains(&path[..end]) {
                self.folders.insert(path[..end].to_owned());
            }
        }
        // A file that does not exist is reported where it is read.
        self.files += u64::from(context.folder.join(path).is_file());
    }

    /// Adds the expected files of a frame. Those of a bundle are added as such.
    pub(super) fn add_frame(&mut self, context: &Context<'_>, frame: &ExpectedFrame) {
        if frame.bundle.is_none() {
            frame.paths.iter().for_each(|path| self.add(context, path));
        }
    }

    /// Adds the expected files of other frames.
    pub(super) fn merge(&mut self, other: Self) {
        self.folders.extend(other.folders);
        self.files += other.files;
    }

    /// Reports everything in the folder that is not expected. `lines` are the frames that were checked, from the first on, and
    /// `others` the expected files that are not frames'.
    pub(super) fn check(
        &self,
        context: &Context<'_>,
        frames: u64,
        others: &[String],
        report: &mut Report,
    ) -> Result<()> {
        let mut files = 0;
        let mut foreign_folders = Vec::new();
        self.walk(context, &mut |_| files += 1, &mut |folder| foreign_folders.push(folder))?;
        // Of frames whose lines are lost the manifest still tells the folders and files.
        let range = context.plan.range;
        let lacks_lines = frames < range.count;
        let frame_folders = context.gate.frame_folders();
        for path in foreign_folders {
            let is_implied =
                lacks_lines && frame_folders.iter().any(|folder| Path::new(folder).starts_with(&path));
            let found = if is_implied {
                "the lines of the frames in this folder are missing from frames.jsonl; run the dataset command again"
            } else {
                "this folder is no part of the dataset; move it elsewhere, or remove it"
            };
            report.problem(name::FILES, Subject::Dataset, format!("{path}: {found}"));
        }
        if files == self.files {
            return Ok(());
        }
        let hash = |path: &str| XxHash3_128::oneshot(path.as_bytes());
        let mut known: HashSet<u128> = others.iter().map(|path| hash(path)).collect();
        for index in (range.start..).take(frames as usize) {
            let line = FrameLine { index, ..FrameLine::default() };
            let frame = ExpectedFrame::new(&context.plan, &context.templates, &line)?;
            if frame.bundle.is_none() {
                known.extend(frame.paths.iter().map(|path| hash(path)));
            }
        }
        let mut foreign = Vec::new();
        let mut add = |path: &str| {
            if !known.contains(&hash(path)) {
                foreign.push(path.to_owned());
            }
        };
        self.walk(context, &mut add, &mut |_| {})?;
        for path in foreign {
            let frame = context.gate.frame_of(&path).filter(|_| lacks_lines);
            let found = if let Some(leftover) = leftover_problem(&path) {
                leftover
            } else if frame.is_some_and(|index| (range.start..range.end()).contains(&index)) {
                "its line is missing from frames.jsonl; run the dataset command again"
            } else {
                "it is no part of the dataset; move it elsewhere, or remove it"
            };
            report.problem(name::FILES, Subject::Dataset, format!("{path}: {found}"));
        }
        Ok(())
    }

    /// Calls `file` with everything in the expected folders that is not a folder, and `foreign` with folders that are not
    /// expected.
    fn walk(
        &self,
        context: &Context<'_>,
        file: &mut dyn FnMut(&str),
        foreign: &mut dyn FnMut(String),
    ) -> Result<()> {
        let root = std::iter::once("");
        for folder in root.chain(self.folders.iter().map(String::as_str)) {
            let path = context.folder.join(folder);
            if !path.is_dir() {
                continue;
            }
            for name in disk::names(&path)? {
                let below = if folder.is_empty() { name.clone() } else { format!("{folder}/{name}") };
                if self.folders.contains(&below) {
                    continue;
                }
                if path.join(&name).is_dir() {
                    foreign(below);
                } else {
                    file(&below);
                }
            }
        }
        Ok(())
    }
}

/// What a file is that a killed run leaves, and what to do; `None` for any other path. A live run has the same files.
fn leftover_problem(path: &str) -> Option<&'static str> {
    let name = path.rsplit_once('/').map_or(path, |(_, name)| name);
    // Locks are in the dataset's own folder only.
    if lock_name(path).is_some() {
        return Some(
            "it is the lock file of a run that was killed, or that is writing now; wait for it to end, or run the dataset command \
             again, which removes what a killed one left",
        );
    }
    temporary_tag(name).map(|_| {
        "it is the unfinished file of a run that was killed, or that is writing now; wait for it to end, or remove the file"
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_killed_runs_leave_is_told_from_strangers() {
        for lock in [".regolith-render-folder.lock", ".regolith-render-0-of-2.lock"] {
            assert!(
                leftover_problem(lock).is_some_and(|found| found.contains("the lock file of a run")),
                "{lock}"
            );
        }
        for file in [".regolith-render-0of1-Ab3dE6gH.tmp", "rgb/.regolith-render-merge-Ab3dE6gH.tmp"] {
            assert!(
                leftover_problem(file).is_some_and(|found| found.contains("the unfinished file")),
                "{file}"
            );
        }
        for stranger in ["notes.txt", ".lock", "rgb/.regolith-render-folder.lock", "rgb/.writing-0of1-abc"] {
            assert_eq!(leftover_problem(stranger), None, "{stranger}");
        }
    }
}
