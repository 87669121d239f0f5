//! Datasets, configurations and masks from somebody else: nothing is written outside `--out`, nothing hangs, nothing panics.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use regolith::output::layout::LAYOUTS;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::support::{folder, json as read_json, program, run_ok};

/// What makes the dataset that the tests change.
const MAKE: [&str; 9] = [
    "dataset",
    "-q",
    "--count=3",
    "--size=48",
    "--samples=1",
    "--set=terrain.cells=40",
    "--set=rocks.count=14",
    "--set=sky.star_count=20",
    "--outputs=rgb,mask,instances",
];

/// A small finished dataset in the format `folder`, to be copied.
static DATASET: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = folder();
    run_ok(folder.path(), &[&MAKE[..], &["--out=data"]].concat());
    folder
});

/// A folder with a copy of the dataset in `data`, and beside it files that nothing may touch.
struct Sandbox(TempDir);

impl Sandbox {
    fn new() -> Self {
        let sandbox = Self(folder());
        let copied =
            Command::new("cp").arg("-r").arg(DATASET.path().join("data")).arg(sandbox.data()).status();
        assert!(copied.expect("cp").success());
        for name in ["evil", "evil/rgb", "evil/mask", "victim"] {
            fs::create_dir_all(sandbox.path().join(name)).expect("created");
            fs::write(sandbox.path().join(name).join("precious"), "precious").expect("written");
        }
        sandbox
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn data(&self) -> PathBuf {
        self.path().join("data")
    }

    fn change_manifest(&self, change: impl FnOnce(&mut Value)) {
        let path = self.data().join("manifest.json");
        let mut manifest = read_json(&path);
        change(&mut manifest);
        fs::write(path, manifest.to_string()).expect("written");
    }

    /// Changes the second line of `frames.jsonl`.
    fn change_line(&self, change: impl FnOnce(&mut Value)) {
        let path = self.data().join("frames.jsonl");
        let text = fs::read_to_string(&path).expect("read");
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let mut line = serde_json::from_str(&lines[1]).expect("JSON");
        change(&mut line);
        lines[1] = line.to_string();
        fs::write(path, lines.join("\n") + "\n").expect("written");
    }

    /// Everything below the folder but `data` and `out`.
    fn outside(&self) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
        let mut found = BTreeMap::new();
        let mut folders = vec![self.path().to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                if [self.data(), self.path().join("out")].contains(&path) {
                    continue;
                }
                if path.is_dir() && !path.is_symlink() {
                    folders.push(path.clone());
                }
                let content = path.is_file().then(|| fs::read(&path).expect("read"));
                found.insert(path, content);
            }
        }
        found
    }

    /// Runs a command, which must end soon, leave everything outside as it was, and not panic.
    #[track_caller]
    fn run(&self, words: &[&str]) -> Output {
        let before = self.outside();
        let output = ends_soon(program(self.path()).args(words));
        assert_eq!(self.outside(), before, "{words:?} touched something outside");
        let message = text(&output);
        assert!(!message.contains("panicked"), "{words:?}: {message}");
        assert!(matches!(output.status.code(), Some(0..=2)), "{words:?}: {:?} {message}", output.status);
        let _ = fs::remove_dir_all(self.path().join("out"));
        output
    }

    /// Runs every command that reads a dataset; each must fail with status 1 and say all of `said`.
    #[track_caller]
    fn refused_by_all(&self, said: &[&str]) {
        let formats = LAYOUTS.iter().map(|row| row.name).filter(|name| *name != "folder");
        let converts = formats.map(|name| vec!["convert", "data", "--out=out", "--format", name]);
        let resumed = [&MAKE[..], &["--out=data"]].concat();
        let others =
            [vec!["verify", "data", "--rerender=0"], vec!["dataset", "--merge", "--out=data"], resumed];
        for words in converts.chain(others) {
            let output = self.run(&words);
            let message = text(&output);
            assert_eq!(output.status.code(), Some(1), "{words:?}: {message}");
            for part in said {
                assert!(message.contains(part), "{words:?} does not say {part}: {message}");
            }
        }
    }
}

/// Runs a command that has to end within a minute.
#[track_caller]
fn ends_soon(command: &mut Command) -> Output {
    let mut child =
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).stdin(Stdio::null()).spawn().expect("started");
    let start = Instant::now();
    while child.try_wait().expect("a process").is_none() {
        if start.elapsed() > Duration::from_secs(60) {
            child.kill().expect("killed");
            panic!("{command:?} does not end");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    child.wait_with_output().expect("ended")
}

/// Everything that a command said.
fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stderr), String::from_utf8_lossy(&output.stdout))
}

#[test]
fn names_in_a_line_never_become_paths() {
    let outside = folder();
    let absolute = outside.path().join("evil").display().to_string();
    for split in ["../evil", "..", &absolute, "a/../../evil", "evil\\x", "evil\0", "train"] {
        let sandbox = Sandbox::new();
        sandbox.change_line(|line| line["split"] = split.into());
        let value = Value::from(split).to_string();
        sandbox.refused_by_all(&["frames.jsonl: line 2: split", &value]);
    }
    for path in ["../evil/precious", "/etc/passwd", "rgb/../../evil/precious", "rgb/rgb_00007.png"] {
        let sandbox = Sandbox::new();
        sandbox.change_line(|line| line["hashes"][path] = "00".into());
        sandbox.refused_by_all(&["frames.jsonl: line 2: hashes", path]);
    }
    for bundle in ["../evil/precious", "/etc/passwd"] {
        let sandbox = Sandbox::new();
        sandbox.change_line(|line| {
            line["hashes"] = json!({});
            line["entry"] = json!({ "bundle": bundle });
        });
        sandbox.refused_by_all(&["frames.jsonl: line 2: entry", bundle]);
    }
    assert_eq!(fs::read_dir(outside.path()).expect("a folder").count(), 0);
}

#[test]
fn names_in_a_manifest_never_become_paths() {
    for split in ["../evil", "/tmp/regolith-evil", "a/b", "", ".."] {
        let sandbox = Sandbox::new();
        sandbox.change_manifest(|manifest| {
            manifest["splits"] = json!({ split: { "start": 0, "count": 3, "seeds": [0, 2] } });
        });
        sandbox.refused_by_all(&["data/manifest.json: splits", split]);
    }
    for path in ["/dev/zero", "/etc/passwd", "../evil/precious", "rgb/../../evil/precious", "thesis.tex"] {
        let sandbox = Sandbox::new();
        sandbox.change_manifest(|manifest| manifest["index_files"][path] = "00".into());
        sandbox.refused_by_all(&["data/manifest.json: index_files", path]);
    }
    for (key, value) in [("format", "../evil"), ("outputs", "../evil"), ("size", "../evil")] {
        let sandbox = Sandbox::new();
        sandbox.change_manifest(|manifest| manifest[key] = value.into());
        sandbox.refused_by_all(&[&format!("data/manifest.json: {key}"), value]);
    }
}

#[test]
fn numbers_beyond_any_dataset_are_refused() {
    for number in [u64::MAX, 1 << 63, (1 << 63) - 1, (1 << 32) + 1] {
        for key in ["count", "start"] {
            let sandbox = Sandbox::new();
            sandbox.change_manifest(|manifest| manifest[key] = number.into());
            sandbox.refused_by_all(&[&format!("data/manifest.json: {key}"), &number.to_string()]);
        }
        let sandbox = Sandbox::new();
        sandbox.change_line(|line| line["index"] = number.into());
        sandbox.refused_by_all(&["frames.jsonl: line 2: index", &number.to_string()]);
    }
    let sandbox = Sandbox::new();
    sandbox.change_manifest(|manifest| manifest["count"] = 0.into());
    sandbox.refused_by_all(&["data/manifest.json: count is 0"]);
    // A number that a line may have, and that a sum overflows with.
    sandbox.change_manifest(|manifest| manifest["count"] = 3.into());
    sandbox.change_line(|line| line["attempt"] = u32::MAX.into());
    assert_eq!(sandbox.run(&["verify", "data", "--rerender=0"]).status.code(), Some(1));
}

/// A manifest may have as many frames as there are. What is missing of them is neither listed nor looked for one by one.
#[cfg(unix)]
#[test]
fn a_huge_number_of_frames_takes_neither_memory_nor_time() {
    let sandbox = Sandbox::new();
    let limited = |words: &[&str]| {
        let whole = program(sandbox.path());
        let mut shell = Command::new("bash");
        shell.args(["-c", "ulimit -v 4000000; exec \"$0\" \"$@\""]).arg(whole.get_program()).args(words);
        let output = ends_soon(shell.current_dir(sandbox.path()));
        assert_eq!(output.status.code(), Some(1), "{words:?}: {}", text(&output));
        text(&output)
    };
    run_ok(sandbox.path(), &["convert", "data", "--format=webdataset", "--out=archives", "-q"]);
    sandbox.change_manifest(|manifest| manifest["count"] = (1_u64 << 32).into());
    for words in
        [&["verify", "data", "--rerender=0"][..], &["convert", "data", "--format=coco", "--out=coco"]]
    {
        limited(words);
    }
    let message = limited(&["dataset", "--merge", "--out=data"]);
    assert!(message.contains("4294967293 frames are missing from data: 3, 4, 5"), "{message}");

    // A line of the last frame is no sign of all before it.
    let archives = sandbox.path().join("archives");
    let path = archives.join("manifest.json");
    let mut manifest = read_json(&path);
    manifest["count"] = (1_u64 << 32).into();
    fs::write(path, manifest.to_string()).expect("written");
    let path = archives.join("frames.jsonl");
    let lines = fs::read_to_string(&path).expect("read");
    let mut last: Value = serde_json::from_str(lines.lines().last().expect("a line")).expect("JSON");
    last["index"] = u32::MAX.into();
    last["hashes"] = json!({});
    last["entry"]["bundle"] = "4294967.tar".into();
    fs::write(path, format!("{lines}{last}\n")).expect("written");
    let message = limited(&["verify", "archives", "--rerender=0"]);
    assert!(message.contains("index is 4294967295; it should be 3"), "{message}");
}

#[test]
fn repeated_keys_are_refused() {
    let sandbox = Sandbox::new();
    let path = sandbox.data().join("manifest.json");
    let manifest = fs::read_to_string(&path).expect("read");
    fs::write(&path, manifest.replacen('{', "{\"count\": 3,", 1)).expect("written");
    sandbox.refused_by_all(&["manifest.json", "the key `count` occurs twice"]);
    fs::write(&path, manifest).expect("written");
    let path = sandbox.data().join("frames.jsonl");
    let lines = fs::read_to_string(&path).expect("read");
    fs::write(&path, lines.replacen("\"knobs\":{", "\"knobs\":{\"rocks.count\":3,", 1)).expect("written");
    let message = text(&sandbox.run(&["verify", "data", "--rerender=0"]));
    assert!(message.contains("line 1 cannot be read: the key `rocks.count` occurs twice"), "{message}");
}

#[cfg(unix)]
#[test]
fn links_below_a_dataset_are_not_followed() {
    use std::os::unix::fs::symlink;
    let resume = [&MAKE[..], &["--out=data"]].concat();
    // Frames are missing, so that the run would write them.
    for name in ["mask", "rgb"] {
        let sandbox = Sandbox::new();
        fs::remove_dir_all(sandbox.data().join(name)).expect("removed");
        symlink(sandbox.path().join("evil").join(name), sandbox.data().join(name)).expect("a link");
        let output = sandbox.run(&resume);
        let message = text(&output);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains(&format!("data/{name} is a symbolic link")), "{message}");
    }
    for name in
        ["manifest.json", "frames.jsonl", ".regolith-render-folder.lock", ".regolith-render-merge.lock"]
    {
        let sandbox = Sandbox::new();
        let (inside, moved) = (sandbox.data().join(name), sandbox.path().join("victim/moved"));
        if inside.exists() {
            fs::rename(&inside, &moved).expect("moved");
        }
        symlink(&moved, &inside).expect("a link");
        fs::remove_file(sandbox.data().join("rgb/rgb_00002.png")).expect("removed");
        let output = sandbox.run(&resume);
        let message = text(&output);
        assert_eq!(output.status.code(), Some(1), "{name}: {message}");
        assert!(message.contains(name) && message.contains("symbolic link"), "{name}: {message}");
    }
    let sandbox = Sandbox::new();
    let image = sandbox.data().join("rgb/rgb_00001.png");
    let moved = sandbox.path().join("victim/image.png");
    fs::rename(&image, &moved).expect("moved");
    symlink(&moved, &image).expect("a link");
    for words in [&["verify", "data", "--rerender=0"][..], &["convert", "data", "--format=coco", "--out=out"]]
    {
        let output = sandbox.run(words);
        let message = text(&output);
        assert!(output.status.code() == Some(1) && message.contains("symbolic link"), "{message}");
    }
    // The dataset's folder itself may be one.
    let sandbox = Sandbox::new();
    symlink(sandbox.data(), sandbox.path().join("named")).expect("a link");
    assert!(sandbox.run(&["verify", "named", "--rerender=0"]).status.success());
}

/// Makes a FIFO.
#[cfg(unix)]
fn make_fifo(path: &Path) {
    let _ = fs::remove_file(path);
    assert!(Command::new("mkfifo").arg(path).status().expect("mkfifo").success());
}

#[cfg(unix)]
#[test]
fn special_files_in_a_dataset_are_refused_before_they_are_opened() {
    for name in ["manifest.json", "frames.jsonl"] {
        let sandbox = Sandbox::new();
        make_fifo(&sandbox.data().join(name));
        for words in [
            &["verify", "data", "--rerender=0"][..],
            &["dataset", "--merge", "--out=data"],
            &["convert", "data", "--format=coco", "--out=out"],
        ] {
            let output = sandbox.run(words);
            let message = text(&output);
            assert!(matches!(output.status.code(), Some(1 | 2)), "{name} {words:?}: {message}");
        }
        let output = sandbox.run(&[&MAKE[..], &["--out=data"]].concat());
        let message = text(&output);
        assert!(output.status.code() == Some(1) && message.contains("FIFO"), "{name}: {message}");
    }
    for name in ["rgb/rgb_00001.png", "README.md"] {
        let sandbox = Sandbox::new();
        make_fifo(&sandbox.data().join(name));
        let output = sandbox.run(&["verify", "data", "--rerender=0"]);
        let message = text(&output);
        assert!(output.status.code() == Some(1) && message.contains(name), "{message}");
        assert!(message.contains("a FIFO"), "{message}");
    }
    let sandbox = Sandbox::new();
    make_fifo(&sandbox.data().join(".regolith-render-folder.lock"));
    fs::remove_file(sandbox.data().join("rgb/rgb_00002.png")).expect("removed");
    let message = text(&sandbox.run(&[&MAKE[..], &["--out=data"]].concat()));
    assert!(message.contains("folder.lock") && message.contains("a FIFO"), "{message}");
}

#[cfg(unix)]
#[test]
fn a_configuration_is_a_file_or_a_pipe_of_bounded_size() {
    let folder = folder();
    // Less memory than such a file would fill.
    let limited = |words: &str| {
        let script = format!("ulimit -v 16000000; exec {} {words}", env!("CARGO_BIN_EXE_regolith-render"));
        ends_soon(Command::new("bash").args(["-c", &script]).current_dir(folder.path()))
    };
    for (words, said) in [
        ("--config /dev/full", "cannot read /dev/full: it is a device"),
        ("--config /dev/zero", "cannot read /dev/zero: it is a device"),
        ("--config <(cat /dev/zero)", "at most 16777216 bytes"),
        ("--config - < /dev/zero", "at most 16777216 bytes"),
        ("--config .", "directory"),
        ("--config missing.toml", "cannot read missing.toml"),
        ("--config <(printf '\\xff')", "not text in UTF-8"),
    ] {
        let output = limited(&format!("dataset --count 1 --dry-run {words}"));
        let message = text(&output);
        assert_eq!(output.status.code(), Some(2), "{words}: {message}");
        assert!(message.contains(said), "{words}: {message}");
    }
    for words in [
        "--config <(echo sun.elevation_deg = 17)",
        "--config - < <(echo sun.elevation_deg = 17)",
        "--config /dev/stdin < <(echo sun.elevation_deg = 17)",
    ] {
        let output = limited(&format!("dataset --count 1 --dry-run {words}"));
        let rows = text(&output);
        let row = rows.lines().find(|line| line.starts_with("sun.elevation_deg")).unwrap_or_default();
        assert!(output.status.success() && row.contains("17"), "{words}: {rows}");
    }
    fs::write(folder.path().join("large.toml"), vec![b'#'; (16 << 20) + 1]).expect("written");
    let message = text(&limited("dataset --count 1 --dry-run --config large.toml"));
    assert!(message.contains("large.toml") && message.contains("at most 16777216 bytes"), "{message}");
}

#[test]
fn a_byte_that_is_not_utf8_makes_a_line_torn_and_no_more() {
    let sandbox = Sandbox::new();
    let before = fs::read(sandbox.data().join("rgb/rgb_00001.png")).expect("read");
    let path = sandbox.data().join("frames.jsonl");
    let mut bytes = fs::read(&path).expect("read");
    let second = bytes.iter().position(|byte| *byte == b'\n').expect("a line") + 20;
    bytes[second] = 0xff;
    fs::write(&path, bytes).expect("written");
    let output = sandbox.run(&["convert", "data", "--format=coco", "--out=out"]);
    let message = text(&output);
    assert!(output.status.code() == Some(1) && message.contains("line 2 cannot be read"), "{message}");
    // The run makes the frame again.
    let output = sandbox.run(&[&MAKE[..], &["--out=data"]].concat());
    assert!(output.status.success(), "{}", text(&output));
    assert!(fs::read(sandbox.data().join("rgb/rgb_00001.png")).expect("read") == before);
    assert!(sandbox.run(&["verify", "data", "--rerender=0"]).status.success());
}

#[test]
fn images_of_another_size_are_refused() {
    for (name, output) in
        [("mask/mask_00001.png", "L8"), ("instances/instance_segmentation_00001.png", "L16")]
    {
        let sandbox = Sandbox::new();
        let image = if output == "L8" {
            image::DynamicImage::ImageLuma8(image::GrayImage::new(7, 2000))
        } else {
            image::DynamicImage::new_luma16(7, 2000)
        };
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).expect("encoded");
        let bytes = bytes.into_inner();
        fs::write(sandbox.data().join(name), &bytes).expect("written");
        sandbox.change_line(|line| {
            line["hashes"][name] = regolith::output::disk::content_hash(&bytes).into();
        });
        // Nor is the digest of any help.
        sandbox.change_manifest(|manifest| {
            manifest.as_object_mut().expect("a manifest").remove("digest");
        });
        for format in ["coco", "cityscapes"] {
            let output = sandbox.run(&["convert", "data", "--format", format, "--out=out"]);
            let message = text(&output);
            assert!(output.status.code() == Some(1) && message.contains(name), "{format}: {message}");
        }
        if output == "L8" {
            let output = sandbox.run(&["dataset", "--merge", "--out=data"]);
            let message = text(&output);
            assert!(output.status.code() == Some(1) && message.contains(name), "{message}");
        }
    }
}

/// A folder with one mask and this label file in `masks`.
fn masks(labels: &str) -> TempDir {
    let folder = folder();
    let masks = folder.path().join("masks");
    fs::create_dir(&masks).expect("created");
    image::GrayImage::new(4, 4).save(masks.join("semantic_segmentation_0000.png")).expect("saved");
    fs::write(masks.join("semantic_segmentation_labels_0000.json"), labels).expect("written");
    folder
}

const LABELS: &str = r#"{"0": {"class": "rock"}}"#;

#[test]
fn label_files_name_each_id_once() {
    for (labels, said) in [
        (r#"{"0": {"class": "rock"}, "0": {"class": "sky"}}"#, "the key `0` occurs twice"),
        (r#"{"0": {"class": "rock", "class": "sky"}}"#, "the key `class` occurs twice"),
        (r#"{"0": {"class": "rock"}, " 0": {"class": "sky"}}"#, "` 0` occurs twice"),
        (r#"{"(1,2,3)": {"class": "rock"}, "(1, 2, 3, 255)": {"class": "sky"}}"#, "occurs twice"),
    ] {
        let folder = masks(labels);
        let output = ends_soon(program(folder.path()).args(["remap", "masks", "--out=out"]));
        let message = text(&output);
        assert_eq!(output.status.code(), Some(2), "{labels}: {message}");
        assert!(message.contains(said), "{labels}: {message}");
    }
}

#[cfg(unix)]
#[test]
fn remap_follows_no_linked_folder_and_reads_no_special_file() {
    use std::os::unix::fs::symlink;
    let folder = masks(LABELS);
    let elsewhere = masks(LABELS);
    for target in [elsewhere.path().join("masks"), folder.path().join("masks")] {
        let link = folder.path().join("masks/link");
        symlink(target, &link).expect("a link");
        let output = ends_soon(program(folder.path()).args(["remap", "masks", "--out=out"]));
        let message = text(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("masks/link") && message.contains("symbolic link"), "{message}");
        fs::remove_file(link).expect("removed");
    }
    for name in ["semantic_segmentation_labels_0000.json", "semantic_segmentation_0000.png"] {
        let folder = masks(LABELS);
        make_fifo(&folder.path().join("masks").join(name));
        let output = ends_soon(program(folder.path()).args(["remap", "masks", "--out=out"]));
        let message = text(&output);
        assert!(matches!(output.status.code(), Some(1 | 2)) && message.contains(name), "{message}");
    }
}

#[test]
fn folders_that_contain_each_other_are_refused() {
    for (source, out) in [("masks", "masks/out"), ("masks", "masks/a/b"), ("masks", "."), ("masks", "masks")]
    {
        let folder = masks(LABELS);
        let words = ["remap", source, "--force", "--out", out];
        let output = ends_soon(program(folder.path()).args(words));
        let message = text(&output);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {message}");
        assert!(message.contains("choose another"), "{message}");
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1);
        assert_eq!(fs::read_dir(folder.path().join("masks")).expect("a folder").count(), 2);
    }
    let sandbox = Sandbox::new();
    for out in ["data/out", "data", "."] {
        let output = sandbox.run(&["convert", "data", "--format=coco", "--force", "--out", out]);
        let message = text(&output);
        assert_eq!(output.status.code(), Some(2), "{out}: {message}");
        assert!(message.contains("choose another"), "{message}");
    }
}

#[test]
fn a_file_of_a_dataset_that_cannot_be_read_is_status_1() {
    let sandbox = Sandbox::new();
    fs::remove_file(sandbox.data().join("frames.jsonl")).expect("removed");
    fs::create_dir(sandbox.data().join("frames.jsonl")).expect("created");
    for words in [
        &["convert", "data", "--format=coco", "--out=out"][..],
        &["verify", "data", "--rerender=0"],
        &["dataset", "--merge", "--out=data"],
        &[&MAKE[..], &["--out=data"]].concat(),
    ] {
        let output = sandbox.run(words);
        let message = text(&output);
        assert!(output.status.code() == Some(1) && message.contains("frames.jsonl"), "{words:?}: {message}");
    }
    let sandbox = Sandbox::new();
    fs::remove_file(sandbox.data().join("mask/mask_00001.png")).expect("removed");
    let output = sandbox.run(&["convert", "data", "--format=coco", "--out=out"]);
    let message = text(&output);
    assert!(output.status.code() == Some(1) && message.contains("mask_00001.png"), "{message}");
}

#[cfg(target_os = "linux")]
#[test]
fn remap_passes_over_no_name_that_is_not_utf8() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt as _;
    for (name, shown) in [
        (&b"part_\xff"[..], "masks/part_\u{fffd}"),
        (b"semantic_segmentation_\xff.png", "masks/semantic_segmentation_\u{fffd}.png"),
        (b"semantic_segmentation_labels_\xff.json", "masks/semantic_segmentation_labels_\u{fffd}.json"),
        (b"notes_\xff.txt", ""),
    ] {
        let folder = masks(LABELS);
        let path = folder.path().join("masks").join(OsStr::from_bytes(name));
        if shown.contains("part") { fs::create_dir(path) } else { fs::write(path, "") }.expect("made");
        let output = ends_soon(program(folder.path()).args(["remap", "masks", "--out=out"]));
        let message = text(&output);
        if shown.is_empty() {
            assert!(output.status.success(), "{message}");
            continue;
        }
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(shown) && message.contains("not UTF-8"), "{message}");
        assert!(!folder.path().join("out").exists());
    }
}
