//! WebDataset: tar shards of [`SHARD_FRAMES`] frames, `000000012.rgb.png` beside `000000012.mask.png` and
//! `000000012.json`.
//!
//! A finished frame is first a fragment (its members, without the end of an archive), so that it survives an
//! interruption. Once all frames exist, the fragments of a shard are joined and removed. Headers hold no time, user or
//! machine.
//! Must not know: scene, GPU.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::frame_line::FrameLine;
use super::interface::{Bundle, CARD_FILE, DatasetIndex, FrameFiles, FrameNames, Layout, Sample, SplitRange};
use crate::error::{Error, Result};
use crate::input;
use crate::output::artifact::{Artifact, EncodedFile, FileKind};
use crate::output::encode::json;
use crate::output::{dataset_path, disk};

/// The WebDataset layout.
#[derive(Debug)]
pub struct WebDataset;

/// Frames of a shard.
pub const SHARD_FRAMES: u64 = 1000;
/// Bytes that are copied at a time.
const PIECE: usize = 1 << 20;
/// Bytes of a block of a tar archive.
const BLOCK: usize = 512;

/// The two zero blocks that end an archive.
#[must_use]
pub fn archive_end() -> Vec<u8> {
    vec![0; 2 * BLOCK]
}

/// File name of the table of shards.
const SHARDS_FILE: &str = "shards.json";

/// File name of a frame's shard. Each split has shards of its own; frames keep their index in the dataset.
fn shard_name(split: &str, index: u64) -> String {
    let shard = index / SHARD_FRAMES;
    if split.is_empty() { format!("{shard:06}.tar") } else { format!("{split}-{shard:06}.tar") }
}

fn fragment_name(index: u64) -> String {
    format!(".parts/{index:09}.tar")
}

/// A frame's key: the part of its members' names before the first dot.
#[must_use]
pub fn sample_key(index: u64) -> String {
    format!("{index:09}")
}

/// Name of an encoded output's field in its sample. The instance mapping is a field of text, though it holds JSON: the loader of Hugging
/// Face learns the keys of a JSON field from the first samples and drops all others, and the keys of the mapping are the ids of rocks.
fn field(file: &EncodedFile) -> String {
    match (file.output, file.extension) {
        ("rgb" | "mask", extension) => format!("{}.{extension}", file.output),
        ("instances", "json") => format!("{}.txt", file.stem),
        (_, extension) => format!("{}.{extension}", file.stem),
    }
}

/// The record of a frame with fields whose types are the same in every sample, as the loader of Hugging Face demands. It learns them from
/// the first samples, where an empty list has no type. Knobs that are drawn per rock or crater are a number in some frames and a
/// distribution in others: distributions have a field of their own.
fn sample_record(line: &FrameLine) -> Result<Map<String, Value>> {
    let failed = |error: serde_json::Error| Error::Encode {
        name: "the record of a sample".to_owned(),
        message: error.to_string(),
    };
    let mut record: Map<String, Value> =
        serde_json::to_value(line).and_then(serde_json::from_value).map_err(failed)?;
    let (distributions, values): (Map<_, _>, Map<_, _>) =
        line.knobs.clone().into_iter().partition(|(_, value)| value.is_object());
    record.insert("knobs".to_owned(), values.into());
    record.insert("knob_distributions".to_owned(), distributions.into());
    let moved_rocks: Vec<String> = line.moved_rocks.iter().map(u32::to_string).collect();
    record.insert("moved_rocks".to_owned(), moved_rocks.join(",").into());
    record.insert("redrawn".to_owned(), line.redrawn.join(",").into());
    Ok(record)
}

impl Layout for WebDataset {
    fn supports(&self, output: &str) -> bool {
        // The metadata are always there, as the sample's JSON; previews are not stored.
        !matches!(output, "preview" | "meta")
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let key = sample_key(sample.record.index);
        let mut fragment = Vec::new();
        for file in sample.files {
            let is_stored =
                self.supports(file.output) && !(file.output == "mask" && file.extension == "json");
            if is_stored {
                append_member(&mut fragment, &format!("{key}.{}", field(file)), &file.bytes)?;
            }
        }
        append_member(
            &mut fragment,
            &format!("{key}.json"),
            &json::to_bytes(&sample_record(sample.record)?)?,
        )?;
        let names = self.frame_names(&[], &sample.record.split, sample.record.index);
        let files =
            names.files.into_iter().map(|name| Artifact { name, bytes: std::mem::take(&mut fragment) });
        Ok(FrameFiles { artifacts: files.collect(), entry: names.entry.into() })
    }

    fn frame_names(&self, _kinds: &[FileKind], split: &str, index: u64) -> FrameNames {
        let entry = [("bundle".to_owned(), shard_name(split, index).into())].into_iter().collect();
        FrameNames { files: vec![fragment_name(index)], entry }
    }

    fn index_paths<'a>(&self, splits: &'a [SplitRange]) -> Box<dyn Iterator<Item = String> + 'a> {
        let shards = splits.iter().flat_map(|split| {
            let end = split.start.saturating_add(split.count);
            // A shard begins at a multiple of its size, or with its split.
            let first = split.start / SHARD_FRAMES * SHARD_FRAMES;
            (first..end).step_by(SHARD_FRAMES as usize).map(|index| shard_name(&split.name, index))
        });
        Box::new(shards.chain([SHARDS_FILE, CARD_FILE].map(str::to_owned)))
    }

    fn write_bundles(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Bundle<'_>) -> Result<()>,
    ) -> Result<()> {
        let mut shard = Shard::default();
        let mut finish = |shard: Shard| {
            if shard.frames.is_empty() {
                return Ok(());
            }
            let parts = shard.parts(index.folder)?;
            write(Bundle { name: &shard.name, content: &|out| join(&parts, out) })?;
            shard.frames.iter().try_for_each(|frame| disk::remove(&index.folder.join(fragment_name(*frame))))
        };
        index.lines.for_each(&mut |line| {
            let name = line.bundle().unwrap_or_default();
            if shard.name != name {
                finish(std::mem::replace(&mut shard, Shard { name: name.to_owned(), frames: Vec::new() }))?;
            }
            shard.frames.push(line.index);
            Ok(())
        })?;
        finish(shard)?;
        disk::remove_empty_folder(&index.folder.join(".parts"));
        Ok(())
    }

    fn index_files(
        &self,
        index: &DatasetIndex<'_>,
        write: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        let mut counts: Vec<(String, u64)> = Vec::new();
        index.lines.for_each(&mut |line| {
            let name = line.bundle().unwrap_or_default();
            match counts.last_mut().filter(|(last, _)| last == name) {
                Some((_, count)) => *count += 1,
                None => counts.push((name.to_owned(), 1)),
            }
            Ok(())
        })?;
        let counts: Map<_, _> = counts.into_iter().map(|(name, count)| (name, count.into())).collect();
        write(Artifact { name: SHARDS_FILE.to_owned(), bytes: json::to_bytes(&counts)? })?;
        write(index.card_file())
    }
}

/// A shard and the indices of its frames, ascending.
#[derive(Default)]
struct Shard {
    name: String,
    frames: Vec<u64>,
}

/// Bytes of a file that become a part of an archive.
struct Part {
    path: PathBuf,
    /// `None` for the whole file.
    range: Option<Range<u64>>,
}

impl Shard {
    /// What the archive consists of: the fragments of its frames. Frames without a fragment are taken from the existing archive: the
    /// dataset has grown, or a run was interrupted between joining and removing.
    fn parts(&self, folder: &Path) -> Result<Vec<Part>> {
        let path = dataset_path::for_reading(folder, &self.name)?;
        // The frames of an archive that was damaged have been made again: each has a fragment.
        let samples = if path.is_file() {
            whole_samples(input::open(&path)?).unwrap_or_default()
        } else {
            BTreeMap::new()
        };
        let part_of = |frame: &u64| {
            let (fragment, key) = (fragment_name(*frame), sample_key(*frame));
            let fragment_path = dataset_path::for_reading(folder, &fragment)?;
            if fragment_path.is_file() {
                Ok(Part { path: fragment_path, range: None })
            } else if let Some(sample) = samples.get(&key) {
                Ok(Part { path: path.clone(), range: Some(sample.clone()) })
            } else {
                Err(Error::CheckFailed(format!(
                    "{}: sample {key} is neither in it nor in {fragment}; run the dataset's command again, which makes the \
                     frame again",
                    path.display()
                )))
            }
        };
        self.frames.iter().map(part_of).collect()
    }
}

/// Writes an archive of these parts.
fn join(parts: &[Part], out: &mut dyn Write) -> std::io::Result<()> {
    let mut piece = vec![0; PIECE];
    // The existing archive, from which many parts may come.
    let mut archive: Option<File> = None;
    let open = |path| input::open(path).map_err(std::io::Error::other);
    for Part { path, range } in parts {
        match range {
            None => copy(&mut open(path)?, u64::MAX, &mut piece, out)?,
            Some(range) => {
                let mut file = archive.take().map_or_else(|| open(path), Ok)?;
                file.seek(SeekFrom::Start(range.start))?;
                copy(&mut file, range.end - range.start, &mut piece, out)?;
                archive = Some(file);
            }
        }
    }
    out.write_all(&archive_end())
}

/// Copies the next bytes of a file, up to its end or to this number.
fn copy(file: &mut File, length: u64, piece: &mut [u8], out: &mut dyn Write) -> std::io::Result<()> {
    let mut rest = length;
    while rest > 0 {
        let wanted = rest.min(piece.len() as u64) as usize;
        match file.read(&mut piece[..wanted]) {
            Ok(0) => break,
            Ok(read) => {
                out.write_all(&piece[..read])?;
                rest -= read as u64;
            }
            Err(cause) if cause.kind() == std::io::ErrorKind::Interrupted => {}
            Err(cause) => return Err(cause),
        }
    }
    Ok(())
}

/// Where each sample of an archive is, by key: all its members with their headers, bytes. Reads headers only.
///
/// # Errors
/// Those of reading, also for bytes that are not an archive.
pub fn samples(archive: impl Read + Seek) -> std::io::Result<BTreeMap<String, Range<u64>>> {
    let mut samples: BTreeMap<String, Range<u64>> = BTreeMap::new();
    for member in tar::Archive::new(archive).entries_with_seek()? {
        let member = member?;
        let name = String::from_utf8_lossy(&member.path_bytes()).into_owned();
        let key = name.split('.').next().unwrap_or_default();
        let start = member.raw_header_position();
        let size = member.size().checked_next_multiple_of(BLOCK as u64);
        let end = size.and_then(|size| member.raw_file_position().checked_add(size));
        let end = end.ok_or(std::io::ErrorKind::InvalidData)?;
        samples.entry(key.to_owned()).or_insert(start..end).end = end;
    }
    Ok(samples)
}

/// The samples of a whole archive, as [`samples`]: all of their members lie within it, and nothing but its end follows the last.
///
/// # Errors
/// Those of [`samples`]; [`std::io::ErrorKind::InvalidData`] for an archive that was cut short or goes on behind its end.
pub fn whole_samples(mut archive: impl Read + Seek) -> std::io::Result<BTreeMap<String, Range<u64>>> {
    let samples = samples(&mut archive)?;
    let end = samples.values().map(|sample| sample.end).max().unwrap_or_default();
    let length = archive.seek(SeekFrom::End(0))?;
    let is_whole = end.checked_add(archive_end().len() as u64) == Some(length);
    if is_whole { Ok(samples) } else { Err(std::io::ErrorKind::InvalidData.into()) }
}

/// Names and contents of the members of a fragment or an archive.
///
/// # Errors
/// Those of reading bytes that are not an archive.
pub fn members(archive: &[u8]) -> std::io::Result<Vec<(String, Vec<u8>)>> {
    let mut members = Vec::new();
    for member in tar::Archive::new(archive).entries()? {
        let mut member = member?;
        let name = String::from_utf8_lossy(&member.path_bytes()).into_owned();
        let mut bytes = Vec::new();
        member.read_to_end(&mut bytes)?;
        members.push((name, bytes));
    }
    Ok(members)
}

/// Appends a file to an archive, with owner 0 and time 0.
fn append_member(archive: &mut Vec<u8>, name: &str, bytes: &[u8]) -> Result<()> {
    let mut header = tar::Header::new_ustar();
    header
        .set_path(name)
        .map_err(|error| Error::Encode { name: name.to_owned(), message: error.to_string() })?;
    header.set_entry_type(tar::EntryType::Regular);
    header.set_mode(0o644);
    header.set_uid(0);
    header.set_gid(0);
    header.set_size(bytes.len() as u64);
    header.set_cksum();
    archive.extend(header.as_bytes());
    archive.extend(bytes);
    archive.resize(archive.len().next_multiple_of(BLOCK), 0);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_samples_have_one_type() {
        let record = |line: Value| {
            let line: FrameLine = serde_json::from_value(line).expect("a line");
            Value::from(sample_record(&line).expect("a record"))
        };
        let mut line = serde_json::json!({
            "index": 7, "attempt": 0, "seed": 9, "stage": "surface", "adapter": "cpu",
            "knobs": { "rocks.roughness": 0.8, "rocks.count": 3 }, "geometry_hash": "ab", "camera": {}, "sun": {},
            "coverage": {}, "rgb": { "mean": 1.0, "p99": 2, "max": 3 }, "moved_rocks": [],
        });
        let plain = record(line.clone());
        line["knobs"]["rocks.roughness"] = serde_json::json!({ "uniform": [0.3, 0.9] });
        line["moved_rocks"] = serde_json::json!([4, 17]);
        line["redrawn"] = serde_json::json!(["black", "lit"]);
        let other = record(line);
        assert_eq!(plain["knobs"], serde_json::json!({ "rocks.roughness": 0.8, "rocks.count": 3 }));
        assert_eq!(other["knobs"], serde_json::json!({ "rocks.count": 3 }));
        assert_eq!(plain["knob_distributions"], serde_json::json!({}));
        assert_eq!(other["knob_distributions"]["rocks.roughness"]["uniform"][1], 0.9);
        assert_eq!([&plain["moved_rocks"], &other["moved_rocks"]], ["", "4,17"]);
        assert_eq!([&plain["redrawn"], &other["redrawn"]], ["", "black,lit"]);
        let keys =
            |record: &Value| record.as_object().expect("an object").keys().cloned().collect::<Vec<_>>();
        assert_eq!(keys(&plain).len(), keys(&other).len());
    }

    /// JSON whose keys differ between samples would lose those that the first samples do not have.
    #[test]
    fn a_mapping_by_rock_is_a_text_and_labels_are_json() {
        let field_of =
            |output, stem, extension| field(&EncodedFile { output, stem, extension, bytes: Vec::new() });
        let mapping = "instance_segmentation_mapping";
        assert_eq!(field_of("instances", mapping, "json"), "instance_segmentation_mapping.txt");
        assert_eq!(field_of("instances", "instance_segmentation", "png"), "instance_segmentation.png");
        assert_eq!(field_of("rock_sizes", "rock_sizes_labels", "json"), "rock_sizes_labels.json");
        assert_eq!(field_of("mask", "semantic_segmentation", "png"), "mask.png");
    }

    #[test]
    fn an_archive_is_written_in_pieces_from_fragments_and_the_one_before() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::create_dir(folder.path().join(".parts")).expect("made");
        let mut expected = Vec::new();
        for (index, length) in [(0, 700), (1, 3 * PIECE + 5), (2, 9)] {
            append_member(&mut expected, &format!("{}.bin", sample_key(index)), &vec![index as u8; length])
                .expect("added");
        }
        expected.extend(archive_end());
        let shard = Shard { name: shard_name("", 0), frames: vec![0, 1, 2] };
        let written = || {
            let (mut bytes, mut largest) = (Vec::new(), 0);
            let parts = shard.parts(folder.path())?;
            join(&parts, &mut Pieces(&mut bytes, &mut largest)).expect("joined");
            assert!(largest <= PIECE, "{largest} bytes at a time");
            Ok::<_, Error>(bytes)
        };
        assert!(
            written().expect_err("no frame is there").to_string().contains("sample 000000000 is neither")
        );
        std::fs::write(folder.path().join(&shard.name), &expected).expect("written");
        assert!(written().expect("all from the archive") == expected);
        // A frame that was made again.
        let range = samples(std::io::Cursor::new(&expected)).expect("an archive")["000000001"].clone();
        let mut again = expected.clone();
        again[range.start as usize + BLOCK] ^= 1;
        let fragment = &again[range.start as usize..range.end as usize];
        std::fs::write(folder.path().join(fragment_name(1)), fragment).expect("written");
        assert!(written().expect("one from its fragment") == again);
    }

    /// Bytes, and the largest number of them that was written at once.
    struct Pieces<'a>(&'a mut Vec<u8>, &'a mut usize);

    impl Write for Pieces<'_> {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            *self.1 = bytes.len().max(*self.1);
            self.0.write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn an_archive_is_divided_into_its_samples() {
        let mut archive = Vec::new();
        let mut sizes = Vec::new();
        for key in ["000000007", "000000008"] {
            let before = archive.len();
            append_member(&mut archive, &format!("{key}.rgb.png"), &[7; 700]).expect("added");
            append_member(&mut archive, &format!("{key}.json"), b"").expect("added");
            sizes.push(archive.len() - before);
        }
        archive.extend(archive_end());
        let samples = samples(std::io::Cursor::new(&archive)).expect("an archive");
        let ranges: Vec<_> = samples.into_iter().collect();
        let [first, both] = [sizes[0], sizes[0] + sizes[1]].map(|size| size as u64);
        assert_eq!(both + 2 * BLOCK as u64, archive.len() as u64);
        assert_eq!(ranges, [("000000007".to_owned(), 0..first), ("000000008".to_owned(), first..both)]);
        let names: Vec<String> =
            members(&archive).expect("an archive").into_iter().map(|member| member.0).collect();
        assert_eq!(names, ["000000007.rgb.png", "000000007.json", "000000008.rgb.png", "000000008.json"]);
        let whole = |archive: &[u8]| whole_samples(std::io::Cursor::new(archive));
        assert_eq!(whole(&archive).expect("whole").len(), 2);
        let longer = [&archive[..], &[0; BLOCK]].concat();
        assert!(whole(&longer).is_err());
        // Also where a member or a sample ends.
        for length in [archive.len() - 1, archive.len() - BLOCK, both as usize, first as usize, 1800, 600, 0]
        {
            assert!(whole(&archive[..length]).is_err(), "{length} of {} bytes", archive.len());
        }
    }
}
