//! The documentation: links, commands and paths that it names must exist.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use regolith::params::config::Config;
use regolith::params::presets::{preset_description, presets};

use crate::support::{folder, run_ok};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Path relative to the repository and text of every page of the documentation.
fn pages() -> Vec<(PathBuf, String)> {
    let mut paths: Vec<PathBuf> =
        ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "shaders/README.md"].map(PathBuf::from).into();
    for entry in std::fs::read_dir(root().join("docs")).expect("docs/") {
        let name = entry.expect("an entry").file_name();
        if name.to_string_lossy().ends_with(".md") {
            paths.push(Path::new("docs").join(name));
        }
    }
    paths.sort();
    let read = |path: &PathBuf| std::fs::read_to_string(root().join(path)).expect("a page");
    paths.iter().map(|path| (path.clone(), read(path))).collect()
}

/// A fenced block of code: its language and its lines.
struct Block<'a> {
    language: &'a str,
    lines: Vec<&'a str>,
}

/// Splits a page into prose (fenced code left out) and fenced blocks, in order.
fn prose_and_blocks(text: &str) -> (String, Vec<Block<'_>>) {
    let (mut prose, mut blocks, mut open) = (String::new(), Vec::new(), None::<Block<'_>>);
    for line in text.lines() {
        match (line.strip_prefix("```"), open.as_mut()) {
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (Some(language), None) => open = Some(Block { language, lines: Vec::new() }),
            (None, Some(block)) => block.lines.push(line),
            (None, None) => {
                prose.push_str(line);
                prose.push('\n');
            }
        }
    }
    assert!(open.is_none(), "a fenced block is not closed");
    (prose, blocks)
}

/// The anchor that GitHub gives a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

fn anchors(text: &str) -> BTreeSet<String> {
    let (prose, _) = prose_and_blocks(text);
    prose
        .lines()
        .filter(|line| line.starts_with('#'))
        .map(|line| anchor(line.trim_start_matches('#')))
        .collect()
}

/// Targets of the links and images in prose, Markdown and HTML, in order.
fn targets(prose: &str) -> Vec<&str> {
    let after = |opening: &'static str, closing| {
        prose.match_indices(opening).map(move |(at, _)| {
            let target = &prose[at + opening.len()..];
            (at, target.split(closing).next().unwrap_or_default())
        })
    };
    let mut found: Vec<_> = after("](", ')').chain(after("src=\"", '"')).collect();
    found.sort_unstable();
    found.into_iter().map(|(_, target)| target).collect()
}

#[test]
fn links_and_images_resolve() {
    let mut checked = 0;
    for (page, text) in pages() {
        let (prose, _) = prose_and_blocks(&text);
        for target in targets(&prose).into_iter().filter(|target| !target.contains("://")) {
            let (path, fragment) = target.split_once('#').unwrap_or((target, ""));
            let file = match path {
                "" => root().join(&page),
                _ => root().join(page.parent().expect("a folder")).join(path),
            };
            assert!(file.exists(), "{}: {target} does not exist", page.display());
            if !fragment.is_empty() {
                let linked = std::fs::read_to_string(&file).expect("a page");
                assert!(
                    anchors(&linked).contains(fragment),
                    "{}: {target} has no such heading",
                    page.display()
                );
            }
            checked += 1;
        }
    }
    assert!(checked > 50, "only {checked} links were found");
}

#[test]
fn every_page_is_in_the_index() {
    let index = std::fs::read_to_string(root().join("docs/README.md")).expect("the index");
    for (page, _) in pages() {
        let name = page.file_name().expect("a name").to_string_lossy().into_owned();
        assert!(index.contains(&format!("{name})")), "docs/README.md does not link {}", page.display());
    }
}

#[test]
fn the_page_on_presets_shows_each_with_its_description() {
    let page = std::fs::read_to_string(root().join("docs/presets.md")).expect("the page").to_lowercase();
    for (name, _) in presets() {
        let description = preset_description(name).expect("a description").to_lowercase();
        let (text, sheet) = (format!("**`{name}`**: {description}"), format!("(presets/{name}.jpg)"));
        assert!(page.contains(&text) && page.contains(&sheet), "docs/presets.md: {text}, {sheet}");
    }
}

#[test]
fn the_readme_is_short() {
    let readme = std::fs::read_to_string(root().join("README.md")).expect("the README");
    let lines = readme.lines().count();
    assert!(lines <= 200, "README.md has {lines} lines: move detail to docs/");
}

/// Words of a shell command; quotes group, comments end it.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), String::new(), None);
    for c in line.chars() {
        match quote {
            Some(open) if c == open => quote = None,
            Some(_) => word.push(c),
            None if c == '\'' || c == '"' => quote = Some(c),
            None if c == '#' && word.is_empty() => break,
            None if c.is_whitespace() => words.extend((!word.is_empty()).then(|| std::mem::take(&mut word))),
            None => word.push(c),
        }
    }
    words.extend((!word.is_empty()).then_some(word));
    words
}

/// Arguments of every call of the program in a shell line, also through `cargo run`.
fn calls(line: &str) -> Vec<Vec<String>> {
    let words = words(line);
    let commands = words.split(|word| ["&&", "|", ";"].contains(&word.as_str()));
    commands
        .filter_map(|command| {
            let start = command.iter().position(|word| word == "regolith-render").or_else(|| {
                let cargo = command.iter().position(|word| word == "cargo")?;
                (command.get(cargo + 1)? == "run").then(|| command.iter().position(|word| word == "--"))?
            })?;
            Some(command[start + 1..].to_vec())
        })
        .collect()
}

/// The options that a subcommand ("" for a frame) takes, by its `--help`.
fn options_of(subcommand: &str) -> BTreeSet<String> {
    let folder = folder();
    let words: Vec<&str> = [subcommand, "--help"].into_iter().filter(|word| !word.is_empty()).collect();
    let help = run_ok(folder.path(), &words);
    let (_, options) = help.split_once("\nOptions:\n").expect("a list of options");
    options
        .lines()
        .filter_map(|line| {
            let line = line.trim_start();
            line.starts_with('-').then(|| line.split_whitespace().take(2))
        })
        .flatten()
        .filter(|word| word.starts_with('-'))
        .map(|word| word.trim_end_matches(',').to_owned())
        .collect()
}

/// Every call of the program in the shell blocks and in the inline code of a page, with the line it stands on.
fn documented_calls(text: &str) -> Vec<(String, Vec<String>)> {
    let (prose, blocks) = prose_and_blocks(text);
    let mut lines: Vec<String> = Vec::new();
    for block in blocks.iter().filter(|block| block.language == "sh") {
        lines.extend(block.lines.join("\n").replace("\\\n", " ").lines().map(str::to_owned));
    }
    let inline = prose.split('`').skip(1).step_by(2).filter(|code| code.starts_with("regolith-render "));
    lines.extend(inline.map(|code| code.replace('\n', " ")));
    lines.iter().flat_map(|line| calls(line).into_iter().map(|call| (line.clone(), call))).collect()
}

#[test]
fn documented_commands_exist() {
    let subcommands = [
        "",
        "dataset",
        "bench",
        "verify",
        "convert",
        "remap",
        "params",
        "presets",
        "adapters",
        "doctor",
        "export",
        "completions",
    ];
    let options: BTreeMap<&str, BTreeSet<String>> =
        subcommands.into_iter().map(|subcommand| (subcommand, options_of(subcommand))).collect();
    let preset_names: BTreeSet<&str> = presets().into_iter().map(|(name, _)| name).collect();
    let mut checked = 0;
    for (page, text) in pages() {
        for (line, call) in documented_calls(&text) {
            let named = call.first().filter(|word| !word.starts_with('-')).map_or("", String::as_str);
            let known =
                options.get(named).unwrap_or_else(|| panic!("{}: {line}: no {named}", page.display()));
            for (index, word) in
                call.iter().enumerate().filter(|(_, word)| word.starts_with('-') && word.len() > 1)
            {
                let option = word.split('=').next().expect("a word");
                assert!(known.contains(option), "{}: {line}: no option {option}", page.display());
                let value = call.get(index + 1).map_or("", String::as_str);
                if option == "--preset" {
                    for name in value.split(',') {
                        assert!(preset_names.contains(name), "{}: {line}: no preset {name}", page.display());
                    }
                }
                if option == "--set" {
                    let set = Config::new().apply_set(value);
                    set.unwrap_or_else(|error| panic!("{}: {line}: {error}", page.display()));
                }
                checked += 1;
            }
        }
    }
    assert!(checked > 60, "only {checked} options were found");
}

/// How far an image of the README may be from what its command makes, mean of 8-bit values: adapters round differently.
const MAX_MEAN_DIFFERENCE: f64 = 0.25;

/// Mean absolute difference of two image files, 8-bit values.
fn mean_difference(a: &Path, b: &Path) -> f64 {
    let [a, b] = [a, b].map(|path| image::open(path).expect("an image").into_rgb8());
    assert_eq!(a.dimensions(), b.dimensions(), "the images have one size");
    let sum: u64 = a.iter().zip(b.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.len() as f64
}

#[test]
fn the_first_command_makes_the_first_images() {
    let readme = std::fs::read_to_string(root().join("README.md")).expect("the README");
    let (prose, _) = prose_and_blocks(&readme);
    let (_, call) = documented_calls(&readme).into_iter().next().expect("a command");
    let folder = folder();
    run_ok(folder.path(), &call.iter().map(String::as_str).collect::<Vec<_>>());
    for (shown, made) in targets(&prose).into_iter().zip(["rgb_0000.png", "preview_0000.png"]) {
        let difference = mean_difference(&root().join(shown), &folder.path().join("out").join(made));
        assert!(
            difference <= MAX_MEAN_DIFFERENCE,
            "{shown} differs from {made} by {difference:.3} in the mean"
        );
    }
}

/// Files and folders that a call reads.
fn inputs(call: &[String]) -> Vec<&str> {
    let mut read: Vec<&str> = call
        .windows(2)
        .filter(|pair| pair[0] == "--config" && pair[1] != "-")
        .map(|pair| pair[1].as_str())
        .collect();
    if ["verify", "convert", "remap"].contains(&call[0].as_str()) {
        read.extend(call.get(1).map(String::as_str));
    }
    read
}

#[test]
fn documented_commands_read_only_what_earlier_ones_write() {
    for (page, text) in pages() {
        let (_, blocks) = prose_and_blocks(&text);
        let mut written: Vec<String> = Vec::new();
        let is_written = |written: &[String], path: &str| {
            written.iter().any(|made| path == made || path.starts_with(&format!("{made}/")))
        };
        for block in &blocks {
            if block.language == "python" {
                let strings = block.lines.iter().flat_map(|line| line.split('"').skip(1).step_by(2));
                let rooted =
                    |text: &&str| ["out/", "data/", "moon/"].iter().any(|root| text.starts_with(root));
                for path in strings.filter(rooted) {
                    assert!(is_written(&written, path), "{}: nothing writes {path}", page.display());
                }
            }
            let script = block.lines.join("\n").replace("\\\n", " ");
            for call in script.lines().filter(|_| block.language == "sh").flat_map(calls) {
                if call.is_empty() {
                    continue;
                }
                for path in inputs(&call) {
                    assert!(is_written(&written, path), "{}: nothing writes {path}", page.display());
                }
                let after =
                    |option: &str| call.windows(2).find(|pair| pair[0] == option).map(|pair| pair[1].clone());
                written.extend(after("--out").or_else(|| Some("out".to_owned())));
                written.extend(after(">"));
            }
        }
    }
}

#[test]
fn named_paths_exist() {
    let roots = ["src/", "shaders/", "tests/", "benches/", "assets/", "docs/"];
    let is_of_path = |c: char| c.is_alphanumeric() || "_/.-".contains(c);
    let mut checked = 0;
    for (page, text) in pages().into_iter().filter(|(page, _)| !page.ends_with("CHANGELOG.md")) {
        for word in text.split(|c| !is_of_path(c)).map(|word| word.trim_end_matches(['.', '/'])) {
            if roots.iter().any(|root| word.starts_with(root)) {
                assert!(root().join(word).exists(), "{} names {word}, which does not exist", page.display());
                checked += 1;
            }
        }
    }
    assert!(checked > 60, "only {checked} paths were found");
}

/// Text of every source file below a folder of the repository.
fn text_below(folder: &Path) -> String {
    let mut text = String::new();
    for entry in std::fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            text += &text_below(&path);
        } else {
            text += &std::fs::read_to_string(&path).expect("a source");
        }
    }
    text
}

#[test]
fn identifiers_in_the_architecture_exist() {
    let page = std::fs::read_to_string(root().join("docs/architecture.md")).expect("the page");
    let (prose, _) = prose_and_blocks(&page);
    let sources = ["src", "shaders", "tests/suite"].map(|folder| text_below(&root().join(folder))).concat();
    let is_of_name = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let names = prose.split('`').skip(1).step_by(2).filter(|code| code.chars().all(is_of_name));
    let mut checked = 0;
    for name in names.filter(|name| name.contains(['_', ':']) || name.contains(char::is_uppercase)) {
        for part in name.split("::") {
            assert!(
                sources.contains(part),
                "docs/architecture.md names `{name}`, which is not in the sources"
            );
        }
        checked += 1;
    }
    assert!(checked > 15, "only {checked} identifiers were found");
}

#[test]
fn the_table_of_modules_is_that_of_the_architecture_test() {
    let page = std::fs::read_to_string(root().join("docs/architecture.md")).expect("the page");
    let names = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<BTreeSet<_>>();
    let mut documented: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for line in page.lines() {
        let cells: Vec<&str> = line.split('|').collect();
        if let [_, modules, _, used, _] = cells[..] {
            documented.extend(names(modules).into_iter().map(|module| (module, names(used))));
        }
    }
    for (module, may_use) in crate::architecture::MAY_USE {
        let expected = may_use.iter().map(|&used| used.to_owned()).collect();
        assert_eq!(documented.get(module), Some(&expected), "docs/architecture.md: `{module}`");
    }
}
