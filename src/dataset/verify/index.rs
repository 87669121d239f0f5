//! The manifest, and the files that belong to no single frame, derived again.
//!
//! Must not know: the files of frames, rendering.

use serde_json::{Map, Value};

use super::command::options_problem;
use super::context::{Context, Version};
use super::differences::{Difference, differences};
use super::report::{Report, Subject, name};
use super::store::archive_problem;
use crate::dataset::plan::Range;
use crate::dataset::totals::Totals;
use crate::dataset::{digest, manifest, merge};
use crate::error::Result;
use crate::output::layout::FrameLine;
use crate::output::{Artifact, dataset_path};

/// Keys of the manifest that name the ids of the masks.
const ID_KEYS: [&str; 3] = ["label_ids", "class_map", "ignore_index"];
/// Index files that are looked for beyond the number of those in the manifest.
const MAX_UNLISTED: usize = 10_000;

/// What the lines amount to.
pub(super) struct LogSummary {
    /// Number of lines that were read and are frames of the dataset.
    pub(super) frames: u64,
    /// The index that the next line should have.
    pub(super) next: u64,
    pub(super) totals: Totals,
    pub(super) digest: digest::Digest,
    /// Whether every line could be read.
    pub(super) is_readable: bool,
}

impl LogSummary {
    pub(super) fn new(context: &Context<'_>) -> Self {
        Self {
            frames: 0,
            next: context.plan.range.start,
            totals: Totals::new(context.plan.settings.size),
            digest: digest::Digest::new(&context.identity()),
            is_readable: true,
        }
    }

    /// Adds a line; says whether it is of a frame of the dataset.
    pub(super) fn add(
        &mut self,
        context: &Context<'_>,
        line: &FrameLine,
        number: u64,
        report: &mut Report,
    ) -> bool {
        self.totals.add(line);
        // A line that was read can be written.
        let _ = self.digest.add(line);
        let range = context.plan.range;
        let is_frame = (range.start..range.end()).contains(&line.index);
        report.expect(name::LOG, Subject::Line(line.index), line.index == self.next, || {
            format!("frames.jsonl, line {number}: index is {}; it should be {}", line.index, self.next)
        });
        if is_frame {
            self.frames += 1;
            self.next = line.index + 1;
        }
        is_frame
    }

    /// Whether there are as many lines as frames, up to the last frame.
    fn is_complete(&self, range: Range) -> bool {
        self.frames == range.count && self.next == range.end()
    }

    /// Number of frames from the first on that the lines are of, those between them included; a line far ahead of the others adds no
    /// more than there are lines.
    pub(super) fn span(&self, range: Range) -> u64 {
        (self.next - range.start).min(2 * self.frames)
    }
}

/// Checks every key of the manifest, and the files that belong to no single frame. Returns the paths of these files.
pub(super) fn check_index(
    context: &Context<'_>,
    summary: &LogSummary,
    report: &mut Report,
) -> Result<Vec<String>> {
    let range = context.plan.range;
    if summary.next != range.end() {
        let found = format!(
            "frames.jsonl ends before frame {}; the manifest has frames {} to {}",
            summary.next,
            range.start,
            range.end() - 1
        );
        report.problem(name::LOG, Subject::Dataset, found);
    }
    let identity = context.identity();
    let options = manifest::options_of(context.manifest);
    if let Some(problem) = options_problem(context, &options) {
        report.problem(name::LOG, Subject::Dataset, format!("manifest.json: command: {problem}"));
    }
    let mut expected = merge::merged_manifest(identity, &options, range, range.count, true, &summary.totals);
    // A number of frames that the manifest does not have the files for is in the report already.
    let listed = context.manifest.get("index_files").and_then(Value::as_object).map_or(0, Map::len);
    let splits = manifest::splits_of(&expected);
    let paths: Vec<String> =
        manifest::index_paths(context.plan.layout, &splits).take(listed + MAX_UNLISTED).collect();
    let hashes = check_index_files(context, summary, &expected, &paths, report);
    expected.insert("index_files".to_owned(), hashes.into());
    if context.manifest.contains_key(digest::KEY) {
        expected.insert(digest::KEY.to_owned(), summary.digest.to_hex().into());
    } else {
        let remedy = "the dataset's command adds it, if it is run again";
        report.problem(
            name::DIGEST,
            Subject::Dataset,
            format!("manifest.json: {} is missing; {remedy}", digest::KEY),
        );
    }
    for check in [name::LOG, name::LABELS, name::DIGEST] {
        report.look(check);
    }
    for Difference { key, text } in differences(&context.manifest.clone().into(), &expected.into()) {
        let top = key.split(['.', '[']).next().unwrap_or_default();
        let check = match top {
            digest::KEY => name::DIGEST,
            "index_files" => name::HASHES,
            top if ID_KEYS.contains(&top) => name::LABELS,
            _ => name::LOG,
        };
        report.problem(check, Subject::Dataset, format!("manifest.json: {text}"));
    }
    Ok(paths)
}

/// Checks the files that belong to no single frame, and returns the hashes that the manifest must have.
fn check_index_files(
    context: &Context<'_>,
    summary: &LogSummary,
    expected: &Map<String, Value>,
    paths: &[String],
    report: &mut Report,
) -> Map<String, Value> {
    let mut hashes = Map::new();
    let recorded = |path: &String| context.manifest.get("index_files")?.get(path)?.as_str();
    for path in paths {
        report.look(name::FILES);
        match dataset_path::hash(context.folder, path) {
            Ok((_, actual)) => {
                let recorded = recorded(path).unwrap_or("nothing");
                report.expect(name::HASHES, Subject::Dataset, recorded == actual, || {
                    format!("{path}: its content has changed (hash {actual}; recorded is {recorded})")
                });
            }
            Err(error) => report.problem(name::FILES, Subject::Dataset, format!("{path}: {error}")),
        }
        // The value has been compared; the key, and that it is a text, are compared with the manifest's other keys.
        hashes.insert(path.clone(), recorded(path).unwrap_or_default().into());
    }
    // Their content is compared only if it must be equal, and if all that it follows from is there.
    if context.version != Version::Same || !summary.is_readable || !summary.is_complete(context.plan.range) {
        return hashes;
    }
    check_archives(context, report);
    let derived = merge::index_files(context.folder, expected, &summary.totals, &mut |file| {
        // A file that is missing is in the report already. One that is larger than expected is not read.
        if dataset_path::hash(context.folder, &file.name).is_ok() {
            let actual = dataset_path::read(context.folder, &file.name, file.bytes.len() as u64);
            check_derived(&file, &actual.unwrap_or_default(), report);
        }
        Ok(())
    });
    if let Err(error) = derived {
        report.problem(
            name::FILES,
            Subject::Dataset,
            format!("the index files cannot be derived again: {error}"),
        );
    }
    hashes
}

/// Compares a file with its derived content.
fn check_derived(file: &Artifact, actual: &[u8], report: &mut Report) {
    let check = match file.name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("png") => name::IMAGES,
        Some("json") => name::LABELS,
        _ => name::LOG,
    };
    report.expect(check, Subject::Dataset, file.bytes == actual, || {
        let lines = [&file.bytes[..], actual].map(|bytes| bytes.split(|byte| *byte == b'\n'));
        let [expected, found] = lines;
        let line = expected.zip(found).position(|(expected, found)| expected != found);
        let place = line
            .filter(|_| check != name::IMAGES)
            .map_or(String::new(), |line| format!(", from line {} on", line + 1));
        format!("{}: it does not follow from manifest.json and the frames{place}", file.name)
    });
}

/// Checks that archives have the frames that they should have and nothing else.
fn check_archives(context: &Context<'_>, report: &mut Report) {
    let range = context.plan.range;
    let bundle_of = |index: u64| {
        let names = context.plan.layout.frame_names(&[], context.plan.split_of(index), index);
        names.entry.get("bundle").and_then(Value::as_str).map(str::to_owned)
    };
    let mut start = range.start;
    while let Some(bundle) = bundle_of(start).filter(|_| start < range.end()) {
        let end = (start..range.end()).find(|index| bundle_of(*index).as_ref() != Some(&bundle));
        let frames = start..end.unwrap_or(range.end());
        start = frames.end;
        let problem = archive_problem(context.folder, &bundle, frames);
        report.look(name::FILES);
        if let Some(found) = problem {
            report.problem(name::FILES, Subject::Dataset, found);
        }
    }
}
