//! Who may import whom, and how long a file and a function may be. The tables are the rules; the sources are held against
//! them.
//!
//! `cargo test --release --test suite architecture -- --nocapture` prints every import circle with the imports it is made of.

use std::collections::{BTreeMap, BTreeSet};

use crate::support::source::{self, ImportGraph, circles, functions, import_graph};

/// Lines of a file below `src` or `shaders`, tests included.
const MAX_FILE_LINES: usize = 500;

/// Lines of a function, from `fn` to its closing brace.
const MAX_FUNCTION_LINES: usize = 80;

/// A comment line that starts so, directly above a function, allows it to be longer, and says why it is.
const LONG_BECAUSE: &str = "// Long because: ";

/// Module and the modules of ours that it may use. A module may always use what is below its own folder.
const MAY_USE: [(&str, &[&str]); 16] = [
    ("error", &[]),
    ("class", &[]),
    ("random", &[]),
    ("lens", &[]),
    ("reuse", &[]),
    ("frame", &["class", "lens"]),
    ("params", &["error", "random"]),
    ("scene", &["params", "random", "lens", "reuse", "class", "error"]),
    ("gpu", &["error"]),
    ("render", &["scene", "gpu", "frame", "lens", "reuse", "class", "error"]),
    ("output", &["frame", "lens", "class", "error"]),
    ("remap", &["output", "class", "error"]),
    ("export", &["scene", "render", "output", "class", "error"]),
    ("meta", &["params", "scene", "render", "output", "frame", "class"]),
    ("bench", &["dataset", "params", "scene", "render", "output", "error"]),
    ("dataset", &["params", "scene", "render", "output", "meta", "frame", "lens", "class", "error"]),
];

/// Files that are in an import circle today. To be emptied: a file that is in none any more must leave the list.
const KNOWN_IN_CIRCLES: &[&str] = &[
    "src/cli.rs",
    "src/cli/bench.rs",
    "src/cli/convert.rs",
    "src/cli/dataset.rs",
    "src/cli/frame.rs",
    "src/cli/progress.rs",
    "src/cli/remap.rs",
    "src/cli/stage.rs",
    "src/cli/verify.rs",
    "src/params.rs",
    "src/params/sampler.rs",
    "src/render/shadow/device.rs",
    "src/scene/rings.rs",
    "src/scene/rocks.rs",
    "src/scene/rocks/on_demand.rs",
    "src/scene/terrain.rs",
];

/// Files that are too long today. To be emptied.
const KNOWN_LONG_FILES: &[&str] = &[
    "src/params.rs",
    "src/params/sampler.rs",
    "src/scene/noise.rs",
    "src/scene/rocks.rs",
    "src/scene/terrain.rs",
];

/// Functions that are too long today, as `file::function`. To be emptied.
const KNOWN_LONG_FUNCTIONS: &[&str] = &["src/cli/frame.rs::run"];

/// The sources of the library and of the binary, apart: they are two crates.
fn crates() -> [BTreeMap<String, String>; 2] {
    let (binary, library) = source::files("src", &["rs"])
        .into_iter()
        .partition(|(file, _)| *file == "src/main.rs" || file.starts_with("src/cli"));
    [library, binary]
}

/// The folder or file directly below `src` that a file belongs to.
fn top_module(file: &str) -> &str {
    let path = file.trim_start_matches("src/").trim_end_matches(".rs");
    path.split('/').next().unwrap_or(path)
}

/// Holds offenders against the list of known ones: an unknown offender is a fault, a known one that is none any more too.
fn assert_only_known(offenders: &BTreeSet<String>, known: &[&str], rule: &str) {
    let new: Vec<&String> = offenders.iter().filter(|name| !known.contains(&name.as_str())).collect();
    assert!(new.is_empty(), "{rule}:\n  {}", new.iter().map(|n| n.as_str()).collect::<Vec<_>>().join("\n  "));
    let gone: Vec<&&str> = known.iter().filter(|name| !offenders.contains(**name)).collect();
    assert!(gone.is_empty(), "no offender any more, remove from the list of known ones: {gone:?}");
}

#[test]
fn modules_import_only_what_they_may() {
    let [library, _] = crates();
    let graph = import_graph(&library);
    let mut wrong = Vec::new();
    for (file, imports) in &graph {
        let module = top_module(file);
        if module == "lib" {
            continue;
        }
        let (_, allowed) = MAY_USE
            .iter()
            .find(|(name, _)| *name == module)
            .unwrap_or_else(|| panic!("{module} has no row in the table MAY_USE"));
        for (target, import) in imports {
            let used = top_module(target);
            if used != module && !allowed.contains(&used) {
                wrong.push(format!("{file}:{}: {} may not use {}", import.line, module, import.path));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    for (module, _) in MAY_USE {
        assert!(graph.keys().any(|file| top_module(file) == module), "the row `{module}` has no module");
    }
}

/// A circle with the import that makes each step, for people.
fn described(graph: &ImportGraph, circle: &[String]) -> String {
    let steps = circle.iter().zip(circle.iter().cycle().skip(1)).map(|(from, to)| {
        let import = &graph[from][to];
        format!("    {from}:{} imports {} ({to})", import.line, import.path)
    });
    format!("  circle of {}:\n{}", circle.len(), steps.collect::<Vec<_>>().join("\n"))
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let (mut offenders, mut report) = (BTreeSet::new(), Vec::new());
    for sources in crates() {
        let graph = import_graph(&sources);
        for circle in circles(&graph) {
            report.push(described(&graph, &circle));
            offenders.extend(circle);
        }
    }
    println!("{} import circles\n{}", report.len(), report.join("\n"));
    assert_only_known(
        &offenders,
        KNOWN_IN_CIRCLES,
        "files in an import circle (--nocapture prints the imports)",
    );
}

/// Every source and shader.
fn code_files() -> BTreeMap<String, String> {
    let mut files = source::files("src", &["rs"]);
    files.extend(source::files("shaders", &["wgsl"]));
    files
}

#[test]
fn no_file_is_too_long() {
    let mut offenders = BTreeSet::new();
    for (file, text) in code_files() {
        let lines = text.lines().count();
        if lines > MAX_FILE_LINES {
            println!("{file}: {lines} lines");
            offenders.insert(file);
        }
    }
    assert_only_known(&offenders, KNOWN_LONG_FILES, &format!("files of more than {MAX_FILE_LINES} lines"));
}

/// Whether the comments and attributes directly above a line (from 1) allow a long function.
fn has_reason_above(lines: &[&str], line: usize) -> bool {
    lines[..line - 1]
        .iter()
        .rev()
        .map(|above| above.trim_start())
        .take_while(|above| above.starts_with("//") || above.starts_with('#'))
        .any(|above| above.starts_with(LONG_BECAUSE) && above.len() > LONG_BECAUSE.len())
}

#[test]
fn no_function_is_too_long_without_a_reason() {
    let mut offenders = BTreeSet::new();
    for (file, text) in code_files() {
        let lines: Vec<&str> = text.lines().collect();
        for function in functions(&source::without_comments_and_strings(&text)) {
            let is_long = function.lines > MAX_FUNCTION_LINES;
            if is_long && !has_reason_above(&lines, function.line) {
                println!("{file}:{}: {} has {} lines", function.line, function.name, function.lines);
                offenders.insert(format!("{file}::{}", function.name));
            }
        }
    }
    let rule =
        format!("functions of more than {MAX_FUNCTION_LINES} lines without `{LONG_BECAUSE}` above them");
    assert_only_known(&offenders, KNOWN_LONG_FUNCTIONS, &rule);
}

#[test]
fn only_output_touches_the_disk() {
    for (file, text) in source::files("src", &["rs"]) {
        let code = source::without_tests(&source::without_comments_and_strings(&text));
        for word in ["fs::write", "File::create", "fs::rename", "OpenOptions"] {
            assert!(
                !code.contains(word) || file == "src/output/disk.rs",
                "{file} uses {word}: only output/disk.rs may"
            );
        }
    }
}
