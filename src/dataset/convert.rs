//! Converting a finished dataset to another layout, without rendering.
//!
//! The planes and encoded files that a layout needs are read back from the frames' files, so that the result equals
//! that of `dataset --format`, to the byte.
//! Must not know: the command line.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use image::DynamicImage;
use rayon::prelude::*;
use serde_json::{Map, Value};

use super::frame_image::decode;
use super::gate::{Gate, no_dataset, read_manifest};
use super::lock::merged_range;
use super::log::{FrameLog, check_digest, find_lines, line_at};
use super::log_writer::{FrameLogWriter, record_files};
use super::manifest::DatasetSpec;
use super::merge::{Finalized, finalize_run};
use super::plan::{Plan, Range};
use crate::class::ClassId;
use crate::error::{Error, RUN_AGAIN, Result};
use crate::frame::{Frame, LabelReason, RockLabel};
use crate::input;
use crate::output::edges::MaskIds;
use crate::output::layout::{self, FrameFiles, FrameLine, FrameLines as _, Layout, Sample, folder};
use crate::output::{
    self, EncodeInput, EncodedFile, FileKind, LabelIds, OUTPUTS, Output, dataset_path, disk,
};

/// Files that are written at a time.
const MAX_OPEN_FILES: usize = 64;
/// Frames that are converted at a time: at most this many, fewer if their files are larger than this together, but one for each core.
const MAX_CHUNK: usize = 64;
const MAX_CHUNK_BYTES: usize = 128 << 20;

/// A conversion of one dataset to one layout.
#[derive(Debug)]
pub struct Conversion {
    manifest: Map<String, Value>,
    gate: Gate,
    layout: &'static dyn Layout,
    spec: DatasetSpec,
    outputs: Vec<&'static Output>,
    label_ids: LabelIds,
}

impl Conversion {
    /// Prepares the conversion of a dataset in the `folder` layout to the layout of this name.
    ///
    /// # Errors
    /// [`Error::Dataset`] if the dataset is not finished, has another layout, or lacks an output; [`Error::Usage`] for an
    /// unknown layout, or one that cannot hold splits of these names; [`Error::CheckFailed`] if its log lacks a frame.
    pub fn new(source: &Path, format: &str) -> Result<Self> {
        let (format, layout) = layout::find(format)?;
        let refused = |message: String| Error::Dataset { path: source.to_owned(), message };
        let path = source.join("manifest.json");
        if !path.is_file() {
            return Err(no_dataset(source));
        }
        let manifest = read_manifest(&path)?;
        let text = |key: &str| manifest.get(key).and_then(Value::as_str).unwrap_or_default();
        if text("format") != "folder" {
            return Err(refused(format!(
                "its format is `{}`; only `folder` can be converted",
                text("format")
            )));
        }
        if text("status") != "done" {
            return Err(refused(
                "it is not finished; run its dataset command again, or `dataset --merge`".to_owned(),
            ));
        }
        let splits = manifest.get("splits").and_then(Value::as_object).into_iter().flatten();
        layout.check_splits(&splits.map(|(name, _)| name.as_str()).collect::<Vec<_>>())?;
        let has = |name: &str| {
            let list = manifest.get("outputs").and_then(Value::as_array);
            list.is_some_and(|list| list.iter().any(|output| output == name))
        };
        if let Some(lacking) = layout.required_outputs().iter().find(|name| !has(name)) {
            return Err(refused(format!(
                "it lacks the output `{lacking}`, which {format} needs; `regolith-render dataset --add-outputs {lacking} {}` adds it",
                source.display()
            )));
        }
        let outputs: Vec<_> =
            OUTPUTS.iter().filter(|output| has(output.name) && layout.supports(output.name)).collect();
        let mut spec = DatasetSpec::of_manifest(&manifest);
        let names: Vec<&str> = outputs.iter().map(|output| output.name).collect();
        spec.identity.insert("format".to_owned(), format.into());
        spec.identity.insert("outputs".to_owned(), names.into());
        let label_ids = LabelIds::of_manifest(&manifest);
        if layout.has_fixed_ids() {
            spec.identity.extend(Plan::identity_of_ids(LabelIds::default()));
        }
        let gate = Gate::of_manifest(&manifest)?;
        check_log(source, &gate, spec.range)?;
        check_digest(source, &manifest, &gate)?;
        Ok(Self { spec, layout, outputs, label_ids, gate, manifest })
    }

    /// Number of frames of the dataset.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.manifest.get("n_completed").and_then(Value::as_u64).unwrap_or_default()
    }

    /// Converts the frames that `out` lacks, and completes it. `watch` is called with the number of frames that existed
    /// before and the number that were added.
    ///
    /// # Errors
    /// [`Error::Dataset`] if `out` has frames that are not of this source, [`Error::Stopped`] once `stop` is true; those of reading and
    /// writing. The same call resumes the conversion.
    pub fn run(
        &self,
        source: &Path,
        out: &Path,
        force: bool,
        stop: &AtomicBool,
        mut watch: impl FnMut(u64, u64),
    ) -> Result<Finalized> {
        self.check_found(source, out, force)?;
        let mut log = FrameLogWriter::open(out, &self.spec, force)?;
        let finished = log.finished().clone();
        let found = finished.len() as u64;
        let mut chunk = Chunk::new();
        let mut convert_chunk = |chunk: &mut Chunk| -> Result<()> {
            let converted: Vec<Result<(FrameLine, FrameFiles)>> =
                chunk.lines.par_drain(..).map(|line| self.convert(source, line)).collect();
            // Of those before an error nothing is lost.
            let (mut frames, mut result) = (Vec::new(), Ok(()));
            for frame in converted {
                match frame {
                    Ok(frame) => frames.push(frame),
                    Err(error) => {
                        result = Err(error);
                        break;
                    }
                }
            }
            write_frames(&mut log, &frames)?;
            chunk.adapt(&frames);
            watch(found, log.finished().len() as u64 - found);
            result?;
            if stop.load(Ordering::Relaxed) {
                log.write_manifest("stopped")?;
                let (done, wanted) = (log.finished().len() as u64, self.frames());
                return Err(Error::Stopped { done, wanted, remedy: RUN_AGAIN });
            }
            Ok(())
        };
        FrameLog::new(source, self.gate.clone()).for_each(&mut |line| {
            if !finished.contains(&line.index) {
                chunk.lines.push(line);
            }
            if chunk.lines.len() >= chunk.size { convert_chunk(&mut chunk) } else { Ok(()) }
        })?;
        convert_chunk(&mut chunk)?;
        log.write_manifest("done")?;
        finalize_run(out, log.close(), self.spec.range, self.spec.shard)
    }

    /// Checks that the frames in `out` are frames of this source: two datasets of one configuration can differ in their number of
    /// frames, and in the adapter that rendered them.
    fn check_found(&self, source: &Path, out: &Path, force: bool) -> Result<()> {
        let other = |what: String| {
            let message =
                format!("{what}; choose another --out, or delete this one to convert {}", source.display());
            Err(Error::Dataset { path: out.to_owned(), message })
        };
        let (own, all) = (self.spec.range, merged_range(out, &self.spec, force)?);
        if all != own {
            return other(format!(
                "it is for frames {} to {} of another conversion, of which {} has {} to {} only",
                all.start,
                all.end().saturating_sub(1),
                source.display(),
                own.start,
                own.end().saturating_sub(1)
            ));
        }
        if !out.exists() {
            return Ok(());
        }
        let found = find_lines(out, &Gate::of_spec(&self.spec)?)?;
        if found.positions.is_empty() {
            return Ok(());
        }
        FrameLog::new(source, self.gate.clone()).for_each(&mut |line| {
            let Some(position) = found.positions.get(&line.index) else { return Ok(()) };
            let converted = line_at(&found.logs[position.log], Some(position))?;
            let index = line.index;
            if as_rendered(line) == as_rendered(converted) {
                return Ok(());
            }
            other(format!("its frame {index} was converted from another dataset"))
        })
    }

    /// A frame's line and files in the new layout.
    fn convert(&self, source: &Path, mut line: FrameLine) -> Result<(FrameLine, FrameFiles)> {
        let ms = std::mem::take(&mut line.ms);
        let hashes = std::mem::take(&mut line.hashes);
        line.entry = Value::Null;
        let size = self.gate.size();
        let mut frame = Frame::default();
        let mut encoded = Vec::new();
        for &output in &self.outputs {
            for kind in output.file_kinds() {
                let FileKind { stem, extension, .. } = kind;
                let path = folder::file_path(kind, &line.split, line.index);
                // What the folder layout stores once, or not for every frame, is encoded again from the mask, which
                // comes earlier in the table of outputs.
                let is_derived = output.name == "preview" || (output.name == "mask" && extension == "json");
                let bytes = if is_derived {
                    self.encode_again(output, extension, &frame)?
                } else {
                    read_checked(source, &path, &hashes, size)?
                };
                match (output.name, extension) {
                    ("mask", "png") => {
                        self.read_mask(&decode(&source.join(&path), &bytes, size)?, &mut frame)
                    }
                    ("instances", "png") => {
                        frame.instances = decode(&source.join(&path), &bytes, size)?.to_luma16().into_raw();
                    }
                    ("instances", "json") => frame.rocks = read_rocks(&source.join(&path), &bytes)?,
                    _ => {}
                }
                encoded.push(EncodedFile { output: output.name, stem, extension, bytes });
            }
        }
        let sample = Sample { frame: &frame, files: &encoded, record: &line };
        let files = self.layout.frame_files(&sample)?;
        record_files(&mut line, &files);
        line.ms = ms;
        Ok((line, files))
    }

    /// An output's file with this extension, encoded from the mask.
    fn encode_again(&self, output: &'static Output, extension: &str, frame: &Frame) -> Result<Vec<u8>> {
        let input =
            EncodeInput { frame, meta: &Value::Null, label_ids: self.label_ids, mask: &MaskIds::default() };
        let files = output::encode(&input, &[output])?;
        let file = files.into_iter().find(|file| file.extension == extension);
        Ok(file.map(|file| file.bytes).unwrap_or_default())
    }

    fn read_mask(&self, mask: &DynamicImage, frame: &mut Frame) {
        let mask = mask.to_luma8();
        (frame.width, frame.height) = mask.dimensions();
        let class_of = |id: u8| {
            let class = ClassId::ALL.iter().find(|class| self.label_ids.mask_id(class.id.0) == id);
            class.map_or(ClassId::UNLABELLED.0, |class| class.id.0)
        };
        frame.class = mask.into_raw().into_iter().map(class_of).collect();
    }
}

/// A line without what depends on the layout and on the run: a conversion leaves the rest as it is.
fn as_rendered(line: FrameLine) -> FrameLine {
    FrameLine { hashes: Map::new(), entry: Value::Null, ms: Map::new(), ..line }
}

/// Frames that are converted at a time.
struct Chunk {
    lines: Vec<FrameLine>,
    /// Number of frames of a full one.
    size: usize,
}

impl Chunk {
    fn new() -> Self {
        Self { lines: Vec::new(), size: rayon::current_num_threads() }
    }

    /// Makes the next chunk as large as the size of these frames' files allows.
    fn adapt(&mut self, frames: &[(FrameLine, FrameFiles)]) {
        let size_of =
            |(_, files): &(_, FrameFiles)| files.artifacts.iter().map(|file| file.bytes.len()).sum::<usize>();
        if let Some(largest) = frames.iter().map(size_of).max() {
            let of_bytes = (MAX_CHUNK_BYTES / largest.max(1)).min(MAX_CHUNK);
            self.size = of_bytes.max(rayon::current_num_threads());
        }
    }
}

/// Writes the files of frames, those of several together, and adds their lines to the log.
fn write_frames(log: &mut FrameLogWriter, frames: &[(FrameLine, FrameFiles)]) -> Result<()> {
    let files_of_frame = frames.iter().map(|(_, files)| files.artifacts.len()).max().unwrap_or_default();
    for group in frames.chunks((MAX_OPEN_FILES / files_of_frame.max(1)).max(1)) {
        log.write_artifacts(group.iter().flat_map(|(_, files)| &files.artifacts))?;
        group.iter().try_for_each(|(line, _)| log.append(line))?;
    }
    log.flush()
}

/// Checks that the log of a dataset has the line of each of its frames.
fn check_log(source: &Path, gate: &Gate, range: Range) -> Result<()> {
    let lacks = |index: u64| {
        Err(Error::CheckFailed(format!(
            "{}: the line of frame {index} is missing, or not in its order; run the dataset command of {} again, which makes the frame \
             again, and then convert it",
            source.join("frames.jsonl").display(),
            source.display()
        )))
    };
    let mut next = range.start;
    FrameLog::new(source, gate.clone()).for_each(&mut |line| {
        if line.index != next {
            return lacks(next);
        }
        next += 1;
        Ok(())
    })?;
    if next < range.end() { lacks(next) } else { Ok(()) }
}

/// Reads a file of the dataset and compares it with its recorded hash.
fn read_checked(source: &Path, path: &str, hashes: &Map<String, Value>, size: [u32; 2]) -> Result<Vec<u8>> {
    let bytes = dataset_path::read(source, path, dataset_path::max_frame_file_bytes(size))?;
    if hashes.get(path).and_then(Value::as_str) == Some(disk::content_hash(&bytes).as_str()) {
        return Ok(bytes);
    }
    Err(Error::CheckFailed(format!(
        "{}: its content has changed since it was written; `verify` says more",
        source.join(path).display()
    )))
}

/// The rocks of an instance mapping.
fn read_rocks(path: &Path, bytes: &[u8]) -> Result<Vec<RockLabel>> {
    let refused =
        |why: &str| Error::CheckFailed(format!("{}: not an instance mapping: {why}", path.display()));
    let incomplete = || refused("it lacks a number");
    let rows: Map<String, Value> = input::json::parse(bytes).map_err(|error| refused(&error.to_string()))?;
    rows.iter()
        .map(|(instance, row)| {
            let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok());
            let visible_px = number(&row["visible_px"])?;
            let side = |i: usize| number(&row["box_px"][i]);
            let box_px = [side(0)?, side(1)?, side(2)?, side(3)?];
            let metres = |name: &str| row[name].as_f64().unwrap_or(0.0) as f32;
            Some(RockLabel {
                instance: instance.parse().ok()?,
                visible_px,
                // The mapping has the occluded fraction instead, which no layout reads.
                exposed_px: visible_px,
                box_px,
                height_m: metres("height_m"),
                diameter_m: metres("diameter_m"),
                // Mappings of earlier versions have rocks that count only.
                reason: row["label"].as_str().and_then(LabelReason::from_name).unwrap_or_default(),
            })
        })
        .collect::<Option<Vec<_>>>()
        .ok_or_else(incomplete)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::Artifact;

    #[test]
    fn fewer_frames_are_converted_at_a_time_the_larger_their_files_are() {
        let threads = rayon::current_num_threads();
        let mut chunk = Chunk::new();
        assert_eq!(chunk.size, threads);
        for (length, expected) in [(1 << 10, MAX_CHUNK), (8 << 20, 16), (1 << 30, 0)] {
            // Memory that is never touched.
            let file = Artifact { name: String::new(), bytes: vec![0; length] };
            let files = FrameFiles { artifacts: vec![file], entry: Value::Null };
            chunk.adapt(&[(FrameLine::default(), files)]);
            assert_eq!(chunk.size, expected.max(threads), "{length} bytes a frame");
        }
        chunk.adapt(&[]);
        assert_eq!(chunk.size, threads);
    }
}
