//! A finished dataset in another layout, without rendering.
//!
//! What the frames' files hold is put back together and given to the other layout, so that the result is that
//! of `dataset --format`, to the byte.
//! Must not know: the command line.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use serde_json::{Map, Value};

use super::journal::{self, Book, Contents, Journal, Settled, hashes, index_of};
use super::plan::{Plan, Shard};
use crate::class::ClassId;
use crate::error::{Error, RUN_AGAIN, Result};
use crate::frame::{Frame, RockLabel};
use crate::output::edges::EdgePolicy;
use crate::output::layout::interface::{FrameFiles, FrameLines as _, Layout, Sample, below_split};
use crate::output::layout::{self, folder};
use crate::output::{self, EncodeInput, EncodedFile, LabelIds, OUTPUTS, disk};

/// Frames that are read at a time.
const CHUNK: usize = 64;

/// What is to be converted, and into what.
#[derive(Debug)]
pub struct Conversion {
    manifest: Map<String, Value>,
    layout: &'static dyn Layout,
    contents: Contents,
    outputs: Vec<&'static output::Output>,
    label_ids: LabelIds,
}

impl Conversion {
    /// Of a dataset in its own layout into the layout of this name.
    ///
    /// # Errors
    /// [`Error::Dataset`] if it is not finished, of another layout, or lacks an output; [`Error::Usage`] for an unknown
    /// layout.
    pub fn new(source: &Path, format: &str) -> Result<Self> {
        let (format, layout) = layout::find(format)?;
        let refused = |message: String| Error::Dataset { path: source.to_owned(), message };
        let path = source.join("manifest.json");
        if !path.is_file() {
            return Err(refused("no dataset is here: it has no manifest.json".to_owned()));
        }
        let manifest = journal::read_manifest(&path)?;
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
        let named = |name: &str| {
            let list = manifest.get("outputs").and_then(Value::as_array);
            list.is_some_and(|list| list.iter().any(|output| output == name))
        };
        if let Some(lacking) = layout.required_outputs().iter().find(|name| !named(name)) {
            return Err(refused(format!(
                "it lacks the output `{lacking}`, without which {format} cannot be; make it with --outputs rgb,mask,{lacking}"
            )));
        }
        let outputs: Vec<_> =
            OUTPUTS.iter().filter(|output| named(output.name) && layout.supports(output.name)).collect();
        let mut contents = Contents::of(&manifest);
        let names: Vec<&str> = outputs.iter().map(|output| output.name).collect();
        contents.identity.insert("format".to_owned(), format.into());
        contents.identity.insert("outputs".to_owned(), names.into());
        let label_ids = LabelIds::of_manifest(&manifest);
        if layout.has_fixed_ids() {
            contents.identity.extend(Plan::identity_of_ids(LabelIds::default()));
        }
        Ok(Self { contents, layout, outputs, label_ids, manifest })
    }

    /// Frames of the dataset.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.manifest.get("n_completed").and_then(Value::as_u64).unwrap_or_default()
    }

    /// Converts what `out` lacks, and settles it. `watch` is told how many frames were there, and how many
    /// were added.
    ///
    /// # Errors
    /// [`Error::Stopped`] once `stop` is true; those of reading and writing. The same call goes on with what is there.
    pub fn run(
        &self,
        source: &Path,
        out: &Path,
        force: bool,
        stop: &AtomicBool,
        mut watch: impl FnMut(u64, u64),
    ) -> Result<Settled> {
        let mut journal = Journal::open(out, &self.contents, force)?;
        let tag = journal::tag(Shard::WHOLE);
        let found = journal.done().len() as u64;
        let mut chunk = Vec::new();
        let mut convert_chunk = |chunk: &mut Vec<Map<String, Value>>| -> Result<()> {
            let made: Vec<Result<(Map<String, Value>, FrameFiles)>> =
                chunk.par_drain(..).map(|line| self.convert(source, line)).collect();
            for made in made {
                let (line, placed) = made?;
                disk::write_all_tagged(out, &tag, &placed.files)?;
                journal.record(index_of(&line).unwrap_or_default(), &line)?;
            }
            watch(found, journal.done().len() as u64 - found);
            if stop.load(Ordering::Relaxed) {
                journal.write_manifest("stopped")?;
                let (done, wanted) = (journal.done().len() as u64, self.frames());
                return Err(Error::Stopped { done, wanted, remedy: RUN_AGAIN });
            }
            Ok(())
        };
        let there = Journal::done_in(out)?;
        Book::new(source).for_each(&mut |line| {
            if index_of(&line).is_some_and(|index| !there.contains(&index)) {
                chunk.push(line);
            }
            if chunk.len() == CHUNK { convert_chunk(&mut chunk) } else { Ok(()) }
        })?;
        convert_chunk(&mut chunk)?;
        journal.write_manifest("done")?;
        drop(journal);
        journal::settle(out)
    }

    /// A frame's line and files in the other layout.
    fn convert(
        &self,
        source: &Path,
        mut line: Map<String, Value>,
    ) -> Result<(Map<String, Value>, FrameFiles)> {
        let index = index_of(&line).unwrap_or_default();
        let split = line.get("split").and_then(Value::as_str).unwrap_or_default().to_owned();
        let recorded: Map<String, Value> =
            hashes(&line).map(|(path, hash)| (path.to_owned(), hash.into())).collect();
        let ms = line.remove("ms");
        line.remove("hashes");
        line.remove("entry");
        let read = |output: &str, stem: &str, extension: &str| -> Result<Vec<u8>> {
            let path = below_split(&split, &folder::file_path(output, stem, extension, index));
            let bytes = disk::read(&source.join(&path))?;
            if recorded.get(&path).and_then(Value::as_str) == Some(disk::content_hash(&bytes).as_str()) {
                return Ok(bytes);
            }
            let path = source.join(path);
            Err(Error::CheckFailed(format!(
                "{}: its content is not what was written; `verify` tells more",
                path.display()
            )))
        };
        let mut frame = Frame::default();
        let mut files = Vec::new();
        for output in &self.outputs {
            for (stem, extension) in output.file_kinds() {
                let file = |bytes| EncodedFile { output: output.name, stem, extension, bytes };
                let again = output.name == "preview" || (output.name == "mask" && extension == "json");
                // What the folder has once, or not of every frame, is made again from the mask, which comes first.
                let bytes = if again {
                    let input = EncodeInput {
                        frame: &frame,
                        meta: &Value::Null,
                        label_ids: self.label_ids,
                        edges: EdgePolicy::Hard,
                    };
                    let made = output::encode(&input, &[*output])?;
                    made.into_iter()
                        .find(|made| made.extension == extension)
                        .map(|made| made.bytes)
                        .unwrap_or_default()
                } else {
                    read(output.name, stem, extension)?
                };
                match (output.name, extension) {
                    ("mask", "png") => self.read_mask(&bytes, &mut frame)?,
                    ("instances", "png") => frame.instances = decode(&bytes)?.into_luma16().into_raw(),
                    ("instances", "json") => frame.rocks = read_rocks(&bytes)?,
                    _ => {}
                }
                files.push(file(bytes));
            }
        }
        let sample = Sample { index, split: &split, frame: &frame, files: &files, record: &line };
        let placed = self.layout.frame_files(&sample)?;
        super::add_files(&mut line, &placed);
        line.extend(ms.map(|ms| ("ms".to_owned(), ms)));
        Ok((line, placed))
    }

    fn read_mask(&self, bytes: &[u8], frame: &mut Frame) -> Result<()> {
        let mask = decode(bytes)?.into_luma8();
        (frame.width, frame.height) = mask.dimensions();
        let class_of = |id: u8| {
            let class = ClassId::ALL.iter().find(|class| self.label_ids.mask_id(class.id.0) == id);
            class.map_or(ClassId::UNLABELLED.0, |class| class.id.0)
        };
        frame.class = mask.into_raw().into_iter().map(class_of).collect();
        Ok(())
    }
}

fn decode(bytes: &[u8]) -> Result<image::DynamicImage> {
    image::load_from_memory(bytes).map_err(|error| Error::Encode {
        name: "a picture of the dataset".to_owned(),
        message: error.to_string(),
    })
}

fn read_rocks(bytes: &[u8]) -> Result<Vec<RockLabel>> {
    let wrong =
        || Error::Encode { name: "an instance mapping".to_owned(), message: "it lacks a number".to_owned() };
    let rows: Map<String, Value> = serde_json::from_slice(bytes).map_err(|_| wrong())?;
    rows.iter()
        .map(|(instance, row)| {
            let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok());
            let visible_px = number(&row["visible_px"])?;
            let side = |place: usize| number(&row["box_px"][place]);
            let box_px = [side(0)?, side(1)?, side(2)?, side(3)?];
            // How much of it is hidden no layout asks for.
            let metres = |name: &str| row[name].as_f64().unwrap_or(0.0) as f32;
            Some(RockLabel {
                instance: instance.parse().ok()?,
                visible_px,
                exposed_px: visible_px,
                box_px,
                height_m: metres("height_m"),
                diameter_m: metres("diameter_m"),
            })
        })
        .collect::<Option<Vec<_>>>()
        .ok_or_else(wrong)
}
