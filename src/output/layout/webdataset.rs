//! WebDataset: tar shards of [`SHARD_FRAMES`] frames, `000000012.rgb.png` beside `000000012.mask.png` and
//! `000000012.json`.
//!
//! A frame is first a fragment (its members without the archive's end), so that it survives a stop; once all frames
//! are there, the fragments of a shard are joined and go. Headers hold nothing of time, user or machine.
//! Must not know: scene, GPU.

use std::collections::BTreeMap;

use serde_json::{Map, json};

use super::interface::{DatasetIndex, FrameFiles, Layout, Sample};
use crate::error::{Error, Result};
use crate::output::artifact::Artifact;
use crate::output::disk;
use crate::output::encode::json;

/// The WebDataset layout.
#[derive(Debug)]
pub struct WebDataset;

/// Frames of a shard.
pub const SHARD_FRAMES: u64 = 1000;
/// Bytes of a block of a tar archive.
const BLOCK: usize = 512;

/// What ends an archive.
#[must_use]
pub fn archive_end() -> Vec<u8> {
    vec![0; 2 * BLOCK]
}

/// The shard of a frame. Splits begin a shard of their own; their frames are counted from that of the dataset's first.
fn shard_name(split: &str, index: u64) -> String {
    let shard = index / SHARD_FRAMES;
    if split.is_empty() { format!("{shard:06}.tar") } else { format!("{split}-{shard:06}.tar") }
}

fn fragment_name(index: u64) -> String {
    format!(".parts/{index:09}.tar")
}

/// Field of an encoded output within its sample: no dots, for the first one ends the key.
fn field(output: &str, stem: &str) -> String {
    match output {
        "rgb" | "mask" => output.to_owned(),
        _ => stem.to_owned(),
    }
}

impl Layout for WebDataset {
    fn supports(&self, output: &str) -> bool {
        // The record is always there, as the sample's JSON; a preview is not.
        !matches!(output, "preview" | "meta")
    }

    fn frame_files(&self, sample: &Sample<'_>) -> Result<FrameFiles> {
        let key = format!("{:09}", sample.index);
        let mut bytes = Vec::new();
        for file in sample.files {
            let is_held = self.supports(file.output) && !(file.output == "mask" && file.extension == "json");
            if is_held {
                let name = format!("{key}.{}.{}", field(file.output, file.stem), file.extension);
                add_member(&mut bytes, &name, &file.bytes)?;
            }
        }
        add_member(&mut bytes, &format!("{key}.json"), &json::to_bytes(sample.record)?)?;
        let fragment = Artifact { name: fragment_name(sample.index), bytes };
        Ok(FrameFiles {
            files: vec![fragment],
            entry: json!({ "bundle": shard_name(sample.split, sample.index) }),
        })
    }

    fn write_index(
        &self,
        index: &DatasetIndex<'_>,
        put: &mut dyn FnMut(Artifact) -> Result<()>,
    ) -> Result<()> {
        let mut shards = Map::new();
        let mut shard: (String, Vec<u64>) = (String::new(), Vec::new());
        let mut flush = |(name, frames): (String, Vec<u64>)| {
            if frames.is_empty() {
                return Ok(());
            }
            shards.insert(name.clone(), frames.len().into());
            // Where the dataset has grown, or a stop came between joining and removing, a part of the frames is in the
            // shard already.
            let path = index.folder.join(&name);
            let joined = if path.is_file() { disk::read(&path)? } else { Vec::new() };
            let joined = samples(&joined);
            let mut bytes = Vec::new();
            for frame in &frames {
                let fragment = index.folder.join(fragment_name(*frame));
                match joined.get(format!("{frame:09}").as_str()) {
                    Some(sample) if !fragment.is_file() => bytes.extend(*sample),
                    _ => bytes.extend(disk::read(&fragment)?),
                }
            }
            bytes.extend(archive_end());
            put(Artifact { name, bytes })?;
            frames.iter().try_for_each(|frame| disk::remove(&index.folder.join(fragment_name(*frame))))
        };
        index.lines.for_each(&mut |line| {
            let name = line.bundle().unwrap_or_default();
            if shard.0 != name {
                flush(std::mem::replace(&mut shard, (name.to_owned(), Vec::new())))?;
            }
            shard.1.push(line.index);
            Ok(())
        })?;
        flush(shard)?;
        disk::remove_empty_folder(&index.folder.join(".parts"));
        put(Artifact { name: "shards.json".to_owned(), bytes: json::to_bytes(&shards)? })?;
        put(index.card_file())
    }
}

/// The samples of an archive by their keys, each with all its members and their headers.
fn samples(archive: &[u8]) -> BTreeMap<&str, &[u8]> {
    let mut samples: BTreeMap<&str, &[u8]> = BTreeMap::new();
    let (mut at, mut start) = (0, 0);
    while let Some(header) = archive.get(at..at + BLOCK).filter(|header| header[0] != 0) {
        let text = |from: usize, to: usize| std::str::from_utf8(&header[from..to]).unwrap_or_default();
        let key = text(0, 100).split('.').next().unwrap_or_default();
        let size = usize::from_str_radix(text(124, 135), 8).unwrap_or_default();
        if !samples.contains_key(key) {
            start = at;
        }
        at = (at + BLOCK + size.next_multiple_of(BLOCK)).min(archive.len());
        samples.insert(key, &archive[start..at]);
    }
    samples
}

/// Adds a file to an archive: POSIX ustar, owner 0, time 0.
fn add_member(archive: &mut Vec<u8>, name: &str, bytes: &[u8]) -> Result<()> {
    let mut header = [0_u8; BLOCK];
    let mut put = |at: usize, text: &[u8]| header[at..at + text.len()].copy_from_slice(text);
    if name.len() > 100 || bytes.len() >= 1 << 33 {
        let message = "its name or content is too long for a tar archive".to_owned();
        return Err(Error::Encode { name: name.to_owned(), message });
    }
    put(0, name.as_bytes());
    put(100, b"0000644\0");
    put(108, b"0000000\0");
    put(116, b"0000000\0");
    put(124, format!("{:011o}\0", bytes.len()).as_bytes());
    put(136, b"00000000000\0");
    // The checksum is taken with spaces in its place.
    put(148, b"        ");
    put(156, b"0");
    put(257, b"ustar\x0000");
    let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    archive.extend(header);
    archive.extend(bytes);
    archive.resize(archive.len().next_multiple_of(BLOCK), 0);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_comes_apart_into_its_samples() {
        let mut archive = Vec::new();
        let mut sizes = Vec::new();
        for key in ["000000007", "000000008"] {
            let before = archive.len();
            add_member(&mut archive, &format!("{key}.rgb.png"), &[7; 700]).expect("added");
            add_member(&mut archive, &format!("{key}.json"), b"").expect("added");
            sizes.push(archive.len() - before);
        }
        archive.extend(archive_end());
        let samples = samples(&archive);
        assert_eq!(samples.keys().copied().collect::<Vec<_>>(), ["000000007", "000000008"]);
        assert_eq!(samples.values().map(|sample| sample.len()).collect::<Vec<_>>(), sizes);
        assert_eq!(
            samples.values().copied().collect::<Vec<_>>().concat(),
            archive[..archive.len() - 2 * BLOCK]
        );
    }
}
