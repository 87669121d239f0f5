//! A dataset folder's own books: `frames.jsonl` (a line for each finished frame) and `manifest.json`.
//!
//! A frame's line is written after its files, so that a line means whole files. A shard keeps books of its own
//! (`frames-0-of-4.jsonl`, `manifest-0-of-4.json`), so that shards can share a folder or be copied into one;
//! [`settle`] makes one out of all.
//! Must not know: how frames come about.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::plan::{Plan, Range, Shard, differences, frame_seed};
use super::summary;
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::output::disk::{self, LineFile, Lock};
use crate::output::layout::{self, DatasetIndex, FrameLines};
use crate::output::{Artifact, encode::json};

/// What stands in a manifest besides the plan's identity.
const STATE_KEYS: [&str; 8] =
    ["status", "start", "count", "n_completed", "seeds", "adapters", "totals", "index_files"];

/// What a dataset is to hold, as far as its books are concerned.
#[derive(Clone, Debug)]
pub struct Contents {
    /// What decides what is in the files.
    pub identity: Map<String, Value>,
    /// The frames.
    pub range: Range,
    /// Whether the frames are split, so that no other range will do.
    pub is_split: bool,
    /// Which of the frames a run makes.
    pub shard: Shard,
}

impl Contents {
    /// What a plan is to make.
    #[must_use]
    pub fn of_plan(plan: &Plan) -> Self {
        Self {
            identity: plan.identity(),
            range: plan.range,
            is_split: !plan.splits.is_empty(),
            shard: plan.shard,
        }
    }

    /// What a settled dataset holds.
    #[must_use]
    pub fn of(manifest: &Map<String, Value>) -> Self {
        let mut identity = manifest.clone();
        identity.retain(|key, _| !STATE_KEYS.contains(&key.as_str()));
        let is_split =
            manifest.get("splits").and_then(Value::as_object).is_some_and(|splits| !splits.is_empty());
        Self { identity, range: range_of(manifest), is_split, shard: Shard::WHOLE }
    }
}

/// The books of one run.
#[derive(Debug)]
pub struct Journal {
    folder: PathBuf,
    identity: Map<String, Value>,
    range: Range,
    shard: Shard,
    lines: LineFile,
    done: BTreeSet<u64>,
    _lock: Lock,
}

fn book_name(stem: &str, extension: &str, shard: Shard) -> String {
    if shard == Shard::WHOLE {
        format!("{stem}.{extension}")
    } else {
        format!("{stem}-{}-of-{}.{extension}", shard.number, shard.of)
    }
}

fn is_book(name: &str, stem: &str, extension: &str) -> bool {
    let middle = name.strip_prefix(stem).and_then(|rest| rest.strip_suffix(&format!(".{extension}")));
    middle.is_some_and(|middle| {
        middle.is_empty()
            || middle
                .strip_prefix('-')
                .and_then(|numbers| numbers.split_once("-of-"))
                .is_some_and(|(i, n)| i.parse::<u64>().is_ok() && n.parse::<u64>().is_ok())
    })
}

/// The books of a kind that a folder has, sorted by name.
fn books(folder: &Path, stem: &str, extension: &str) -> Result<Vec<PathBuf>> {
    let mut names = disk::names(folder)?;
    names.retain(|name| is_book(name, stem, extension));
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

/// Content of a manifest.
///
/// # Errors
/// [`Error::Read`], [`Error::CheckFailed`].
pub fn read_manifest(path: &Path) -> Result<Map<String, Value>> {
    serde_json::from_slice(&disk::read(path)?).map_err(|error| {
        Error::CheckFailed(format!(
            "{}: not a manifest ({error}); delete it, and the dataset's own command with --force makes it again",
            path.display()
        ))
    })
}

fn range_of(manifest: &Map<String, Value>) -> Range {
    let number = |key: &str| manifest.get(key).and_then(Value::as_u64).unwrap_or_default();
    Range { start: number("start"), count: number("count") }
}

/// The index of a frame's line.
#[must_use]
pub fn index_of(line: &Map<String, Value>) -> Option<u64> {
    line.get("index").and_then(Value::as_u64)
}

/// The files of a frame's line with their hashes.
pub fn hashes(line: &Map<String, Value>) -> impl Iterator<Item = (&str, &str)> {
    let hashes = line.get("hashes").and_then(Value::as_object);
    hashes.into_iter().flatten().filter_map(|(path, hash)| Some((path.as_str(), hash.as_str()?)))
}

/// Whether a frame's files are there, by themselves or in the bundle that has taken them in.
fn is_there(folder: &Path, line: &Map<String, Value>) -> bool {
    let bundle = line.get("entry").and_then(|entry| entry.get("bundle")).and_then(Value::as_str);
    // None is empty but by an accident.
    let is_there =
        |path: &str| folder.join(path).metadata().is_ok_and(|file| file.is_file() && file.len() > 0);
    bundle.is_some_and(is_there)
        || (hashes(line).next().is_some() && hashes(line).all(|(path, _)| is_there(path)))
}

/// Where a frame's line stands.
struct LinePlace {
    /// Which of the books.
    book: usize,
    /// Bytes before it.
    offset: u64,
    /// Its own bytes.
    length: usize,
}

/// The books of a folder and, by frame, where the newest whole line stands of those whose files are there.
fn find_lines(folder: &Path) -> Result<(Vec<PathBuf>, BTreeMap<u64, LinePlace>)> {
    let books = books(folder, "frames", "jsonl")?;
    let mut places = BTreeMap::new();
    for (book, path) in books.iter().enumerate() {
        let unreadable = |cause| Error::Read { path: path.clone(), cause };
        let mut reader = match std::fs::File::open(path) {
            // Another shard has completed the folder just now; its one book has these lines.
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => continue,
            file => BufReader::new(file.map_err(unreadable)?),
        };
        let (mut offset, mut text) = (0, String::new());
        loop {
            text.clear();
            let length = reader.read_line(&mut text).map_err(unreadable)?;
            if length == 0 {
                break;
            }
            // A line that is torn or foreign does not count.
            let line = text
                .ends_with('\n')
                .then(|| serde_json::from_str::<Map<String, Value>>(&text).ok())
                .flatten();
            if let Some(line) = line
                && let Some(index) = index_of(&line)
                && is_there(folder, &line)
            {
                places.insert(index, LinePlace { book, offset, length });
            }
            offset += length as u64;
        }
    }
    Ok((books, places))
}

/// The frames of a plan and of the dataset that its folder holds, if that is the same dataset.
fn hull_with(folder: &Path, contents: &Contents, force: bool) -> Result<Range> {
    if folder.is_file() {
        return Err(Error::OutIsFile(folder.to_owned()));
    }
    let Contents { identity, is_split, .. } = contents;
    let mut range = contents.range;
    let manifests = if folder.exists() { books(folder, "manifest", "json")? } else { Vec::new() };
    for path in &manifests {
        let manifest = match read_manifest(path) {
            // Another shard has completed the folder just now.
            Err(Error::Read { .. }) if !path.exists() => continue,
            manifest => manifest?,
        };
        let mut differences = differences(&manifest, identity);
        let there = range_of(&manifest);
        if *is_split && there != contents.range {
            differences
                .push(format!("  --split: there {} frames, now {}", there.count, contents.range.count));
        }
        if !differences.is_empty() {
            let is_own =
                path.ends_with(book_name("manifest", "json", contents.shard)) && manifests.len() == 1;
            if is_own && find_lines(folder)?.1.is_empty() {
                // A run that has not come to a single frame: nothing of it is lost.
                continue;
            }
            return Err(Error::OtherDataset { path: folder.to_owned(), differences });
        }
        if there.start > range.end() || there.end() < range.start {
            return Err(Error::Usage(format!(
                "--start {} --count {}: the folder has frames {} to {}; frames in between would be missing. Choose a \
                 range that adjoins, or another --out",
                contents.range.start,
                contents.range.count,
                there.start,
                there.end().saturating_sub(1)
            )));
        }
        range = range.hull(there);
    }
    if manifests.is_empty() {
        // A run that was stopped at its very beginning, or another shard at its own, has left no more than this.
        let begun = |name: &str| name.starts_with(".lock") || is_book(name, "frames", "jsonl");
        if let Err(foreign) = disk::check_content(folder, force, begun) {
            // Another shard may have begun just now.
            let is_ours = folder.is_dir() && !books(folder, "manifest", "json")?.is_empty();
            return if is_ours { hull_with(folder, contents, force) } else { Err(foreign) };
        }
    }
    Ok(range)
}

impl Journal {
    /// Whether a run may go on in a folder, and the frames that are there; writes nothing.
    ///
    /// # Errors
    /// [`Error::OtherDataset`], [`Error::OutNotEmpty`], [`Error::OutIsFile`], [`Error::Usage`] for frames that would
    /// leave a gap.
    pub fn check(folder: &Path, contents: &Contents, force: bool) -> Result<BTreeSet<u64>> {
        hull_with(folder, contents, force)?;
        Self::done_in(folder)
    }

    /// Whether a folder has a manifest of some run.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn is_begun(folder: &Path) -> Result<bool> {
        Ok(folder.is_dir() && !books(folder, "manifest", "json")?.is_empty())
    }

    /// The frames that are in a folder, which need not exist.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn done_in(folder: &Path) -> Result<BTreeSet<u64>> {
        Ok(if folder.exists() { find_lines(folder)?.1.into_keys().collect() } else { BTreeSet::new() })
    }

    /// Opens the books of a folder for a run, which goes on with what is there.
    ///
    /// # Errors
    /// Those of [`Self::check`], [`Error::Busy`], [`Error::Write`].
    pub fn open(folder: &Path, contents: &Contents, force: bool) -> Result<Self> {
        let range = hull_with(folder, contents, force)?;
        let shard = contents.shard;
        let write = |path: &Path, cause| Error::Write { path: path.to_owned(), cause };
        std::fs::create_dir_all(folder).map_err(|cause| write(folder, cause))?;
        let lock = folder.join(format!(".lock-{}-of-{}", shard.number, shard.of));
        let lock = Lock::try_acquire(&lock)?.ok_or_else(|| Error::Busy(folder.to_owned()))?;
        disk::remove_temporary(folder, &tag(shard))?;
        let (_, places) = find_lines(folder)?;
        let journal = Self {
            lines: LineFile::open(&folder.join(book_name("frames", "jsonl", shard)))?,
            folder: folder.to_owned(),
            identity: contents.identity.clone(),
            range,
            shard,
            done: places.into_keys().collect(),
            _lock: lock,
        };
        journal.write_manifest("running")?;
        Ok(journal)
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The frames whose files are there.
    #[must_use]
    pub const fn done(&self) -> &BTreeSet<u64> {
        &self.done
    }

    /// Writes a frame's line; its files are there.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn record(&mut self, index: u64, line: &Map<String, Value>) -> Result<()> {
        self.lines.append(&Value::Object(line.clone()).to_string())?;
        self.done.insert(index);
        Ok(())
    }

    /// Writes the run's manifest.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_manifest(&self, status: &str) -> Result<()> {
        self.lines.sync()?;
        let range = self.range;
        let own = self.done.range(range.start..range.end()).filter(|index| self.shard.has(**index)).count();
        let mut manifest = Map::new();
        manifest.insert("status".to_owned(), status.into());
        manifest.insert("start".to_owned(), range.start.into());
        manifest.insert("count".to_owned(), range.count.into());
        manifest.insert("n_completed".to_owned(), own.into());
        manifest.extend(self.identity.clone());
        let name = book_name("manifest", "json", self.shard);
        disk::write_all_tagged(&self.folder, &tag(self.shard), &[pretty(name, manifest)?]).map(drop)
    }
}

/// The tag of a shard's temporary files.
#[must_use]
pub fn tag(shard: Shard) -> String {
    format!("{}of{}-", shard.number, shard.of)
}

fn pretty(name: String, content: Map<String, Value>) -> Result<Artifact> {
    Ok(Artifact { name, bytes: json::to_bytes(&content.into())? })
}

/// The lines of a book, one after the other.
#[derive(Debug)]
pub struct Book(PathBuf);

impl Book {
    /// The frames of a dataset that is settled.
    #[must_use]
    pub fn new(folder: &Path) -> Self {
        Self(folder.join("frames.jsonl"))
    }

    /// Gives one line after the other, or why it cannot be read.
    ///
    /// # Errors
    /// [`Error::Read`], and those of `visit`.
    pub fn for_each_as_it_is(
        &self,
        visit: &mut dyn FnMut(Result<Map<String, Value>>) -> Result<()>,
    ) -> Result<()> {
        let unreadable = |cause| Error::Read { path: self.0.clone(), cause };
        let file = std::fs::File::open(&self.0).map_err(unreadable)?;
        for (number, text) in BufReader::new(file).split(b'\n').enumerate() {
            let line = serde_json::from_slice(&text.map_err(unreadable)?);
            visit(line.map_err(|error| {
                Error::CheckFailed(format!(
                    "{}: line {} cannot be read: {error}",
                    self.0.display(),
                    number + 1
                ))
            }))?;
        }
        Ok(())
    }
}

impl FrameLines for Book {
    fn for_each(&self, visit: &mut dyn FnMut(Map<String, Value>) -> Result<()>) -> Result<()> {
        self.for_each_as_it_is(&mut |line| visit(line?))
    }
}

/// What a settled folder holds.
#[derive(Clone, Debug)]
pub struct Settled {
    /// Its manifest.
    pub manifest: Map<String, Value>,
    /// The frames that are not there yet.
    pub missing: Vec<u64>,
}

/// Makes one `frames.jsonl` by rising index and one `manifest.json` out of the books of all runs, and, once every
/// frame is there, what a finished dataset has besides: index files, data card, pictures. Harmless to repeat.
///
/// # Errors
/// [`Error::Dataset`] if the folder has no manifest, [`Error::OtherDataset`] if its shards are of different
/// configurations, [`Error::Read`], [`Error::Write`].
pub fn settle(folder: &Path) -> Result<Settled> {
    let manifests = || if folder.is_dir() { books(folder, "manifest", "json") } else { Ok(Vec::new()) };
    let none = || Error::Dataset {
        path: folder.to_owned(),
        message: "no dataset is here: it has no manifest.json".to_owned(),
    };
    if manifests()?.is_empty() {
        return Err(none());
    }
    let lock = Lock::acquire(&folder.join(".lock"))?;
    // Another shard that was settling meanwhile has taken its books away.
    let manifests = manifests()?;
    let first = manifests.first().ok_or_else(none)?;
    let mut identity = read_manifest(first)?;
    let mut range = range_of(&identity);
    identity.retain(|key, _| !STATE_KEYS.contains(&key.as_str()));
    for path in &manifests[1..] {
        let manifest = read_manifest(path)?;
        let differences = differences(&manifest, &identity);
        if !differences.is_empty() {
            return Err(Error::OtherDataset { path: path.clone(), differences });
        }
        range = range.hull(range_of(&manifest));
    }
    let (books, places) = find_lines(folder)?;
    disk::write_streamed(&folder.join("frames.jsonl"), |out| {
        let mut files = books.iter().map(std::fs::File::open).collect::<std::io::Result<Vec<_>>>()?;
        for &LinePlace { book, offset, length } in places.values() {
            let mut line = vec![0; length];
            files[book].seek(SeekFrom::Start(offset))?;
            files[book].read_exact(&mut line)?;
            out.write_all(&line)?;
        }
        Ok(())
    })?;
    let missing: Vec<u64> = (range.start..range.end()).filter(|index| !places.contains_key(index)).collect();
    let totals = Totals::of(&Book::new(folder))?;
    let mut manifest = Map::new();
    let status = if missing.is_empty() { "done" } else { "incomplete" };
    let base_seed = identity.get("base_seed").and_then(Value::as_u64).unwrap_or_default();
    let seeds = [range.start, range.end().saturating_sub(1)].map(|index| frame_seed(base_seed, index, 0));
    for (key, value) in [
        ("status", status.into()),
        ("start", range.start.into()),
        ("count", range.count.into()),
        ("n_completed", places.len().into()),
        ("seeds", serde_json::json!(seeds)),
        ("adapters", serde_json::json!(totals.adapters)),
        ("totals", totals.to_json()),
    ] {
        manifest.insert(key.to_owned(), value);
    }
    manifest.extend(identity);
    if missing.is_empty() {
        let files = write_index(folder, &manifest, &totals)?;
        manifest.insert("index_files".to_owned(), files.into());
    }
    disk::write_all(folder, &[pretty("manifest.json".to_owned(), manifest.clone())?])?;
    if missing.is_empty() {
        let settled = ["frames.jsonl", "manifest.json"].map(|name| folder.join(name));
        for path in books.iter().chain(&manifests).filter(|path| !settled.contains(path)) {
            disk::remove(path)?;
        }
        disk::remove_temporary(folder, "")?;
        for name in disk::names(folder)?.iter().filter(|name| name.starts_with(".lock")) {
            disk::remove(&folder.join(name))?;
        }
    }
    drop(lock);
    Ok(Settled { manifest, missing })
}

/// Writes what a finished dataset has besides its frames, and gives the hashes of these files.
fn write_index(folder: &Path, manifest: &Map<String, Value>, totals: &Totals) -> Result<Map<String, Value>> {
    let name = manifest.get("format").and_then(Value::as_str).unwrap_or_default();
    let (_, layout) = layout::find(name)?;
    let lines = Book::new(folder);
    let card = summary::card(manifest, totals);
    let mut hashes = Map::new();
    let mut put = |artifact: Artifact| {
        hashes.insert(artifact.name.clone(), disk::content_hash(&artifact.bytes).into());
        disk::write_all(folder, &[artifact]).map(drop)
    };
    layout.write_index(&DatasetIndex { folder, lines: &lines, manifest, card: &card }, &mut put)?;
    put(summary::histograms(&lines)?)?;
    if let Some(sheet) = summary::contact_sheet(folder, &lines, layout)? {
        put(sheet)?;
    }
    Ok(hashes)
}

/// Sums over the frames of a dataset.
#[derive(Clone, Debug, Default)]
pub struct Totals {
    /// How many.
    pub frames: u64,
    /// Sum of the shares of each class in its place of [`ClassId::ALL`].
    coverage: [f64; ClassId::ALL.len()],
    rgb_mean: f64,
    /// How often frames were drawn again, by rule.
    pub redraws: BTreeMap<String, u64>,
    /// Names of the adapters.
    pub adapters: BTreeSet<String>,
}

impl Totals {
    /// Of these lines.
    ///
    /// # Errors
    /// Those of reading.
    pub fn of(lines: &dyn FrameLines) -> Result<Self> {
        let mut totals = Self::default();
        lines.for_each(&mut |line| {
            totals.add(&line);
            Ok(())
        })?;
        Ok(totals)
    }

    /// Adds a frame's line.
    pub fn add(&mut self, line: &Map<String, Value>) {
        let number = |section: &str, key: &str| {
            line.get(section).and_then(|section| section.get(key)).and_then(Value::as_f64).unwrap_or_default()
        };
        self.frames += 1;
        self.rgb_mean += number("rgb", "mean");
        for (sum, class) in self.coverage.iter_mut().zip(ClassId::ALL) {
            *sum += number("coverage", class.name);
        }
        let rules = line.get("redrawn").and_then(Value::as_array);
        for rule in rules.into_iter().flatten().filter_map(Value::as_str) {
            *self.redraws.entry(rule.to_owned()).or_default() += 1;
        }
        if let Some(adapter) = line.get("adapter").and_then(Value::as_str) {
            self.adapters.insert(adapter.to_owned());
        }
    }

    /// Mean share of a class, by its place in [`ClassId::ALL`].
    #[must_use]
    pub fn coverage(&self, class: usize) -> f64 {
        self.coverage[class] / self.frames.max(1) as f64
    }

    /// Mean of the pictures' mean values.
    #[must_use]
    pub fn rgb_mean(&self) -> f64 {
        self.rgb_mean / self.frames.max(1) as f64
    }

    /// As they stand in a manifest.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let coverage: Map<String, Value> = ClassId::ALL
            .iter()
            .enumerate()
            .map(|(i, class)| (class.name.to_owned(), self.coverage(i).into()))
            .collect();
        serde_json::json!({ "redraws": self.redraws, "coverage_mean": coverage, "rgb_mean": self.rgb_mean() })
    }
}
