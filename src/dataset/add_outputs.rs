//! Further outputs for a finished dataset, which keeps every file that it has.
//!
//! Its frames are rendered again from its manifest, with the outputs that it has and those that are added. Only if all that it has comes
//! out again, line and hashes, the new files of a frame are written; so they belong to the same pixels. They are kept track of in a log of
//! their own, `frames-added.jsonl`, which has the new lines:
//!
//! 1. Files of a frame are written, then its line in that log. The dataset is what it was; an interrupted run is continued.
//! 2. Once all frames are there, the manifest says what the dataset will hold, and is `running`. Its frames count as unfinished now.
//! 3. `frames.jsonl` is replaced by the new lines, the log is removed, and the folder is completed as after any other run.
//!
//! Must not know: the command line.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use serde_json::{Map, Value, json};

use super::gate::{Gate, MAX_LINE_BYTES, no_dataset, read_manifest};
use super::lock::RunLock;
use super::log::{FoundLines, LinePosition, find_lines, has_files, line_at};
use super::manifest;
use super::merge::{Finalized, finalize_run, find_complete};
use super::pipeline::{Concurrency, FinishedFrame, render_frames};
use super::plan::{Plan, Range, Shard};
use crate::error::{Error, RUN_AGAIN, Result};
use crate::input::{self, Lines};
use crate::output::disk::{self, FileWriter, LineFile};
use crate::output::layout::{FrameFiles, FrameLine};
use crate::output::{self, FileKind, Output, dataset_path};
use crate::render::Renderer;

/// File name of the log of what is added. Its first line names the outputs.
const ADDED_FILE: &str = "frames-added.jsonl";
/// Key of its first line.
const HEADER: &str = "adds";

/// Outputs that are added to a dataset.
#[derive(Debug)]
pub struct Addition {
    folder: PathBuf,
    manifest: Map<String, Value>,
    /// With the outputs that the dataset has and those that are added.
    plan: Plan,
    /// Names of those that are added; empty if the dataset has them all.
    added: Vec<&'static str>,
    /// Gates of the lines before and after.
    gates: [Gate; 2],
}

/// What an addition has done.
#[derive(Debug)]
pub struct Added {
    /// Frames that were rendered.
    pub made: u64,
    /// The dataset.
    pub finalized: Finalized,
}

impl Addition {
    /// Prepares the addition of a comma-separated list of outputs. Writes nothing.
    ///
    /// # Errors
    /// [`Error::Dataset`] if the folder is no finished dataset of this version, or its layout cannot be added to; [`Error::Usage`] for an
    /// output that is unknown or that the layout does not hold.
    pub fn new(folder: &Path, list: &str) -> Result<Self> {
        let refused = |message: String| Error::Dataset { path: folder.to_owned(), message };
        let path = folder.join("manifest.json");
        if !path.is_file() {
            return Err(no_dataset(folder));
        }
        let manifest = read_manifest(&path)?;
        let text = |key: &str| manifest.get(key).and_then(Value::as_str).unwrap_or_default();
        if text("version") != env!("CARGO_PKG_VERSION") {
            return Err(refused(format!(
                "it was made by version {}, whose frames this version, {}, does not make; add the outputs with that version",
                text("version"),
                env!("CARGO_PKG_VERSION")
            )));
        }
        let mut plan = Plan::of_manifest(&manifest)?;
        let requested = output::parse_outputs_of("--add-outputs", list)?;
        let all = list.split(',').any(|word| word.trim() == "all");
        let unsupported = requested.iter().find(|output| !all && !plan.layout.supports(output.name));
        if is_bundled(&plan) || unsupported.is_some() {
            let what = unsupported.map_or("further outputs", |output| output.name);
            return Err(refused(format!(
                "its format, {}, has no place for {what}; add the outputs to the dataset of format folder, and `convert` that, or make \
                 this dataset again with --outputs",
                plan.format
            )));
        }
        let has = |output: &Output| plan.outputs.iter().any(|own| own.name == output.name);
        let added: Vec<&str> = requested
            .iter()
            .filter(|output| plan.layout.supports(output.name) && !has(output))
            .map(|output| output.name)
            .collect();
        let is_done = text("status") == "done";
        let is_begun = folder.join(ADDED_FILE).is_file();
        if !is_done && (!added.is_empty() || !is_begun && text("status") != "running") {
            return Err(refused(
                "it is not finished; run its dataset command again, or `dataset --merge`".to_owned(),
            ));
        }
        plan.outputs =
            output::OUTPUTS.iter().filter(|output| has(output) || added.contains(&output.name)).collect();
        plan.settings.annotations = output::annotations(&plan.outputs);
        let gates = [Gate::of_manifest(&manifest)?, Gate::of_identity(&plan.identity(), plan.range)?];
        Ok(Self { folder: folder.to_owned(), manifest, plan, added, gates })
    }

    /// Number of frames of the dataset.
    #[must_use]
    pub const fn frames(&self) -> u64 {
        self.plan.range.count
    }

    /// Whether no frame has to be rendered: the dataset has all of the outputs already.
    #[must_use]
    pub fn is_rendered(&self) -> bool {
        self.added.is_empty()
    }

    /// Completes a dataset that has all of the outputs already: an earlier addition may have been stopped at its end.
    ///
    /// # Errors
    /// [`Error::Dataset`] if frames are missing, or the addition of other outputs is not finished; [`Error::Busy`]; those of reading and
    /// writing.
    pub fn complete(&self) -> Result<Added> {
        if !self.folder.join(ADDED_FILE).exists()
            && let Some(finalized) = find_complete(&self.folder)?
        {
            return Ok(Added { made: 0, finalized });
        }
        let lock = RunLock::acquire(&self.folder, Shard::WHOLE)?;
        let of_log = self.outputs_of_log()?;
        let has = |name: &&str| self.plan.outputs.iter().any(|output| output.name == *name);
        if !of_log.iter().all(has) {
            return Err(self.unfinished(&of_log));
        }
        if !of_log.is_empty() {
            let log = AddedLog::open(self, &of_log, &ExistingLines::of_log(&self.folder)?)?;
            if log.positions.len() as u64 == self.frames() {
                return Ok(Added { made: 0, finalized: self.switch(log, lock)? });
            }
            disk::remove(&log.path)?;
        }
        ExistingLines::find(self, &self.gates[1])?;
        Ok(Added { made: 0, finalized: finalize_run(&self.folder, lock, self.plan.range, Shard::WHOLE)? })
    }

    /// The error of an addition beside another one.
    fn unfinished(&self, of_log: &[&str]) -> Error {
        let names = of_log.join(",");
        let message =
            format!("an addition of {names} is not finished; finish it first, by --add-outputs {names}");
        Error::Dataset { path: self.folder.clone(), message }
    }

    /// Renders the frames that lack the outputs and completes the dataset. `watch` is called with the number of frames that had them
    /// before and of those that were made.
    ///
    /// # Errors
    /// [`Error::CheckFailed`] if a frame does not come out as it is in the dataset: then nothing is added, and what was added before is
    /// removed. [`Error::Stopped`] once `stop` is true; the same call continues. [`Error::Busy`]; those of rendering and writing.
    pub fn run(
        &self,
        renderer: &mut Renderer,
        concurrency: Concurrency,
        stop: &AtomicBool,
        mut watch: impl FnMut(u64, u64) + Send,
    ) -> Result<Added> {
        let lock = RunLock::acquire(&self.folder, Shard::WHOLE)?;
        if read_manifest(&self.folder.join("manifest.json"))? != self.manifest {
            let holder = "its manifest has just changed".to_owned();
            return Err(Error::Busy { path: self.folder.clone(), holder });
        }
        let existing = ExistingLines::find(self, &self.gates[0])?;
        lock.remove_leftovers(&self.file_folders())?;
        let mut log = AddedLog::open(self, &self.added, &existing)?;
        let missing: Vec<u64> = self.indices().filter(|index| !log.positions.contains_key(index)).collect();
        let (found, mut made, wanted) = (log.positions.len() as u64, 0, missing.len() as u64);
        watch(found, made);
        let mut has_moved = false;
        let result = render_frames(&self.plan, renderer, missing.into_iter(), concurrency, stop, |frame| {
            let old = existing.line(frame.index)?;
            let (line, files) = match same(&old, frame) {
                Ok(new) => new,
                Err(error) => {
                    has_moved = true;
                    return Err(error);
                }
            };
            log.add(&line, &files)?;
            made += 1;
            watch(found, made);
            Ok(())
        });
        let flushed = log.flush();
        if has_moved {
            self.take_back(&existing, &log)?;
        }
        result?;
        flushed?;
        if made < wanted {
            return Err(Error::Stopped { done: found + made, wanted: found + wanted, remedy: RUN_AGAIN });
        }
        Ok(Added { made, finalized: self.switch(log, lock)? })
    }

    fn indices(&self) -> std::ops::Range<u64> {
        let Range { start, .. } = self.plan.range;
        start..self.plan.range.end()
    }

    /// The outputs that the log of an earlier addition names; none if there is no log.
    fn outputs_of_log(&self) -> Result<Vec<&'static str>> {
        let path = self.folder.join(ADDED_FILE);
        if !path.is_file() {
            return Ok(Vec::new());
        }
        let mut text = Vec::new();
        Lines::open(&dataset_path::own_file(&path)?, MAX_LINE_BYTES)?.next_into(&mut text)?;
        let header: Value = input::json::parse(&text).unwrap_or_default();
        let is_named =
            |name: &&str| header[HEADER].as_array().is_some_and(|list| list.iter().any(|it| it == name));
        Ok(output::OUTPUTS.iter().map(|output| output.name).filter(is_named).collect())
    }

    /// The folders, below the dataset's, of the files of frames.
    fn file_folders(&self) -> BTreeSet<String> {
        let kinds: Vec<FileKind> = self.plan.outputs.iter().copied().flat_map(Output::file_kinds).collect();
        let firsts = manifest::splits_of(&self.manifest).into_iter();
        let names =
            firsts.flat_map(|split| self.plan.layout.frame_names(&kinds, &split.name, split.start).files);
        names.filter_map(|path| Some(path.rsplit_once('/')?.0.to_owned())).collect()
    }

    /// Makes the added lines those of the dataset, and completes it.
    fn switch(&self, log: AddedLog, lock: RunLock) -> Result<Finalized> {
        let AddedLog { mut writer, positions, path, .. } = log;
        let (identity, range) = (self.plan.identity(), self.plan.range);
        let mut running = Map::new();
        running.insert("status".to_owned(), "running".into());
        running.insert("start".to_owned(), range.start.into());
        running.insert("count".to_owned(), range.count.into());
        running.insert("n_completed".to_owned(), range.count.into());
        running.extend(manifest::command(&manifest::options_of(&self.manifest), &identity, range));
        running.extend(identity);
        writer.write_all(&[manifest::to_file("manifest.json".to_owned(), running)?])?;
        writer.sync_folders()?;
        let mut file = input::open(&path)?;
        writer.write_streamed("frames.jsonl", |out| {
            for &LinePosition { offset, length, .. } in positions.values() {
                let mut line = vec![0; length];
                file.seek(SeekFrom::Start(offset))?;
                file.read_exact(&mut line)?;
                out.write_all(&line)?;
            }
            Ok(())
        })?;
        writer.sync_folders()?;
        disk::remove(&path)?;
        finalize_run(&self.folder, lock, range, Shard::WHOLE)
    }

    /// Removes all that was added.
    fn take_back(&self, existing: &ExistingLines, log: &AddedLog) -> Result<()> {
        let mut folders = BTreeSet::new();
        for_each_line(&log.path, |new, _| {
            if !existing.positions.contains_key(&new.index) || self.gates[1].check(&new).is_err() {
                return Ok(());
            }
            let old = existing.line(new.index)?;
            for path in new.hashes.keys().filter(|path| !old.hashes.contains_key(*path)) {
                disk::remove(&dataset_path::for_writing(&self.folder, path)?)?;
                folders.extend(path.rsplit_once('/').map(|(folder, _)| folder.to_owned()));
            }
            Ok(())
        })?;
        folders.iter().for_each(|folder| disk::remove_empty_folder(&self.folder.join(folder)));
        disk::remove(&log.path)
    }
}

/// Whether the files of frames end up in archives, which are not opened again.
fn is_bundled(plan: &Plan) -> bool {
    let kinds: Vec<FileKind> = plan.outputs.iter().copied().flat_map(Output::file_kinds).collect();
    plan.layout.frame_names(&kinds, "", plan.range.start).entry.contains_key("bundle")
}

/// The line of a frame with its new files, and these, if all that the dataset has of it came out again.
fn same(old: &FrameLine, frame: FinishedFrame) -> Result<(FrameLine, FrameFiles)> {
    let FinishedFrame { mut line, mut files, .. } = frame;
    if let Some((what, now, there)) = difference(old, &line) {
        let short = |value: &Value| value.to_string().chars().take(80).collect::<String>();
        return Err(Error::CheckFailed(format!(
            "frame {}: rendered again, its `{what}` is {}; in the dataset it is {}. Outputs are added by the version, adapter and --raster \
             that made the dataset only, so that they belong to the same pixels. Nothing was added; `verify --rerender` says more",
            old.index,
            short(&now),
            short(&there)
        )));
    }
    files.artifacts.retain(|file| !old.hashes.contains_key(&file.name));
    line.ms = old.ms.clone();
    Ok((line, files))
}

/// The first key or file of a frame's line that is another in its new line, with the new value and the old one.
fn difference(old: &FrameLine, new: &FrameLine) -> Option<(String, Value, Value)> {
    let without_files = |line: &FrameLine| {
        json!(FrameLine { hashes: Map::new(), entry: Value::Null, ms: Map::new(), ..line.clone() })
    };
    let (found, expected) = (without_files(new), without_files(old));
    let changed =
        expected.as_object().into_iter().flatten().find(|(key, value)| found.get(key) != Some(value));
    changed.map(|(key, value)| (key.clone(), found[key].clone(), value.clone())).or_else(|| {
        let changed = old.hashes.iter().find(|(path, hash)| new.hashes.get(*path) != Some(hash));
        changed.map(|(path, hash)| {
            (path.clone(), new.hashes.get(path).cloned().unwrap_or_default(), hash.clone())
        })
    })
}

/// Passes each line of a log that can be read to `visit`, with its position. Returns the length of the log, bytes.
fn for_each_line(path: &Path, mut visit: impl FnMut(FrameLine, LinePosition) -> Result<()>) -> Result<u64> {
    let mut lines = Lines::open(&dataset_path::own_file(path)?, MAX_LINE_BYTES)?;
    let (mut text, mut offset) = (Vec::new(), 0);
    while lines.next_into(&mut text)?.is_some() {
        if let Ok(line) = FrameLine::parse(&text) {
            visit(line, LinePosition { log: 0, offset, length: text.len() })?;
        }
        offset += text.len() as u64;
    }
    Ok(offset)
}

/// The lines that a dataset has, read one at a time.
struct ExistingLines {
    path: PathBuf,
    positions: BTreeMap<u64, LinePosition>,
}

impl ExistingLines {
    /// Those that pass a gate; all frames must have one.
    fn find(addition: &Addition, gate: &Gate) -> Result<Self> {
        let FoundLines { logs, positions, .. } = find_lines(&addition.folder, gate)?;
        let path = addition.folder.join("frames.jsonl");
        let missing = addition.frames() - positions.range(addition.indices()).count() as u64;
        if missing > 0 || logs != [path.clone()] {
            let message = format!(
                "{missing} of its {} frames are not on the disk; run its dataset command again, which makes them",
                addition.frames()
            );
            return Err(Error::Dataset { path: addition.folder.clone(), message });
        }
        Ok(Self { path, positions })
    }

    /// The last of each frame in `frames.jsonl`, whatever files the frame has.
    fn of_log(folder: &Path) -> Result<Self> {
        let path = folder.join("frames.jsonl");
        let mut positions = BTreeMap::new();
        for_each_line(&path, |line, position| {
            positions.insert(line.index, position);
            Ok(())
        })?;
        Ok(Self { path, positions })
    }

    fn line(&self, index: u64) -> Result<FrameLine> {
        line_at(&self.path, self.positions.get(&index))
    }

    /// Whether a frame with this new line is that of the dataset: it may have been made again since.
    fn agree_with(&self, new: &FrameLine) -> Result<bool> {
        Ok(self.positions.contains_key(&new.index) && difference(&self.line(new.index)?, new).is_none())
    }
}

/// The log of what is added, and the writer of the files.
struct AddedLog {
    path: PathBuf,
    writer: FileWriter,
    lines: LineFile,
    length: u64,
    positions: BTreeMap<u64, LinePosition>,
    /// Lines of frames whose files are written, but whose names may not be on the disk yet.
    waiting: Vec<(u64, String)>,
}

impl AddedLog {
    /// Opens the log of an addition of these outputs to frames with these lines, or begins it.
    fn open(addition: &Addition, added: &[&'static str], existing: &ExistingLines) -> Result<Self> {
        let path = addition.folder.join(ADDED_FILE);
        let of_log = addition.outputs_of_log()?;
        if !of_log.is_empty() && of_log != added {
            return Err(addition.unfinished(&of_log));
        }
        if of_log.is_empty() {
            // Without its first line it has no other.
            dataset_path::check_own_file(&path)?;
            disk::remove(&path)?;
        }
        let mut writer = FileWriter::new(&addition.folder, &Shard::WHOLE.tag());
        // With splits no file lies in the folder but this log, whose name must be on the disk as theirs are.
        writer.create_folder()?;
        let mut log = Self {
            writer,
            lines: LineFile::open(&path)?,
            path,
            length: 0,
            positions: BTreeMap::new(),
            waiting: Vec::new(),
        };
        if of_log.is_empty() {
            log.append(&json!({ HEADER: added }).to_string())?;
        } else {
            log.read(addition, existing)?;
        }
        Ok(log)
    }

    /// Reads the lines whose files exist and that agree with those of the dataset.
    fn read(&mut self, addition: &Addition, existing: &ExistingLines) -> Result<()> {
        let [_, gate] = &addition.gates;
        let positions = &mut self.positions;
        self.length = for_each_line(&self.path, |line, position| {
            if gate.check(&line).is_ok()
                && gate.lists_all_files(&line)
                && has_files(&addition.folder, &line)?
                && existing.agree_with(&line)?
            {
                positions.insert(line.index, position);
            } else {
                positions.remove(&line.index);
            }
            Ok(())
        })?;
        Ok(())
    }

    /// Writes the new files of a frame, and after a fraction of a second its line.
    fn add(&mut self, line: &FrameLine, files: &FrameFiles) -> Result<()> {
        self.writer.write_all(&files.artifacts)?;
        let text = serde_json::to_string(line)
            .map_err(|error| Error::Encode { name: ADDED_FILE.to_owned(), message: error.to_string() })?;
        self.waiting.push((line.index, text));
        if self.writer.is_sync_due() { self.flush() } else { Ok(()) }
    }

    /// Appends the lines that wait, after the names of their files are on the disk.
    fn flush(&mut self) -> Result<()> {
        self.writer.sync_folders()?;
        for (index, text) in std::mem::take(&mut self.waiting) {
            let position = LinePosition { log: 0, offset: self.length, length: text.len() + 1 };
            self.append(&text)?;
            self.positions.insert(index, position);
        }
        self.lines.sync()
    }

    fn append(&mut self, line: &str) -> Result<()> {
        self.lines.append(line)?;
        self.length += line.len() as u64 + 1;
        Ok(())
    }
}
