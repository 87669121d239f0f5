//! The words of this repository are those of its field. Each banned word has the word to write instead.
//!
//! The rules hold for sources, shaders, tests, documents, presets, recipes and everything that `--help` prints. Identifiers
//! are split into their words, so that `PictureArgs` and `picture_px` are found as well as "picture".

use std::collections::BTreeMap;

use crate::support::{self, source};

/// Where a word must not be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scope {
    /// In sources, shaders, tests, documents, presets, help.
    Everywhere,
    /// In sources, shaders, tests and help.
    Code,
}
use Scope::{Code, Everywhere};

/// A word or phrase in small letters (a `*` at its end stands for any ending), its scope, and what to write instead.
const BANNED: &[(&str, Scope, &str)] = &[
    ("reckon*", Everywhere, "compute"),
    ("sift", Everywhere, "cull"),
    ("sifts", Everywhere, "culls"),
    ("sifted", Everywhere, "culled"),
    ("sifting", Everywhere, "culling"),
    ("anew", Everywhere, "again"),
    ("heed*", Everywhere, "honour, respect"),
    ("owed", Everywhere, "the term of the rule, for instance top_left_bias"),
    ("whither", Everywhere, "where"),
    ("whence", Everywhere, "where from"),
    ("thence", Everywhere, "from there"),
    ("beheld", Everywhere, "seen"),
    ("nought", Everywhere, "zero, nothing"),
    ("lest", Everywhere, "so that ... not"),
    ("of late", Everywhere, "recently"),
    ("this program", Everywhere, "the host, the CPU rasteriser, regolith-render"),
    ("picture*", Everywhere, "image (pixel grid, file) or frame (image with its labels)"),
    ("nearness", Everywhere, "inverse depth"),
    ("before the lens", Everywhere, "nearer than the near plane"),
    ("beneath notice", Everywhere, "negligible"),
    ("turned away", Everywhere, "back-facing"),
    ("what samples show", Everywhere, "the G-buffer, the visible surface at a sample"),
    ("what the samples show", Everywhere, "the G-buffer, the visible surface at a sample"),
    ("what a sample shows", Everywhere, "the visible surface at a sample"),
    ("what each sample shows", Everywhere, "the visible surface at each sample"),
    ("told apart", Everywhere, "distinguished"),
    ("tell apart", Everywhere, "distinguish"),
    ("tells apart", Everywhere, "distinguishes"),
    ("lit alike", Everywhere, "shaded by the same pipeline"),
    ("drawn here", Everywhere, "rasterised by the host"),
    ("twin", Everywhere, "CPU counterpart, copy"),
    ("twins", Everywhere, "CPU counterparts, copies"),
    ("trouble", Everywhere, "pending error, problem"),
    ("some64", Code, "SampleBatch"),
    ("so many", Code, "the number: `count` bytes"),
    ("thing", Code, "surface, object, instance, rock, whichever it is"),
    ("things", Code, "surfaces, objects, instances, rocks, whichever they are"),
];

/// How a name must not begin, and how instead.
const BANNED_PREFIXES: [(&str, &str); 5] =
    [("MOST_", "MAX_"), ("LEAST_", "MIN_"), ("most_", "max_"), ("least_", "min_"), ("by_axis", "to_soa")];

/// Doc comments that say nothing beyond the name they stand at.
const EMPTY_DOCS: [&str; 6] = ["Them.", "It.", "Its.", "As above.", "The same.", "Likewise."];

/// Names that contain a banned word and stay: a check in the reports of `verify`, a term of COCO.
const EXEMPT: [&str; 2] = ["\"pictures\"", "is_thing"];

/// Small words of a text, each with its line from 1: identifiers split, comment marks dropped. The end of a sentence is an empty
/// word, so that no phrase is found across it.
fn words(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (line, text) in (1..).zip(text.lines()) {
        let (mut word, mut before) = (String::new(), ' ');
        for c in text.chars().chain([' ']) {
            let begins = c.is_uppercase() && before.is_lowercase();
            if (!c.is_alphanumeric() || begins) && !word.is_empty() {
                found.push((line, std::mem::take(&mut word)));
            }
            if c.is_alphanumeric() {
                word.extend(c.to_lowercase());
            } else if ".;:!?".contains(c) {
                found.push((line, String::new()));
            }
            before = c;
        }
    }
    found
}

/// Whether the words from `i` on are this phrase.
fn is_phrase(words: &[(usize, String)], i: usize, phrase: &[&str]) -> bool {
    words.len() >= i + phrase.len()
        && words[i..].iter().zip(phrase).all(|((_, word), wanted)| {
            wanted.strip_suffix('*').map_or(word == wanted, |stem| word.starts_with(stem))
        })
}

/// What is wrong with a text: a line for each finding.
fn findings(name: &str, text: &str, is_code: bool) -> Vec<String> {
    let mut found = Vec::new();
    let text = EXEMPT.iter().fold(text.to_owned(), |text, name| text.replace(name, "_"));
    let words = words(&text);
    for (banned, scope, instead) in BANNED {
        let phrase: Vec<&str> = banned.split(' ').collect();
        if *scope == Everywhere || is_code {
            let hits = (0..words.len()).filter(|&i| is_phrase(&words, i, &phrase));
            found.extend(hits.map(|i| format!("{name}:{}: `{banned}`: write {instead}", words[i].0)));
        }
    }
    for (line, text) in (1..).zip(text.lines()) {
        for (prefix, instead) in BANNED_PREFIXES.iter().filter(|_| is_code) {
            let begins =
                |(i, _): (usize, &str)| !text[..i].ends_with(|c: char| c.is_alphanumeric() || c == '_');
            if text.match_indices(prefix).any(begins) {
                found.push(format!("{name}:{line}: a name with `{prefix}`: write {instead}"));
            }
        }
        let doc = text.trim_start().strip_prefix("/// ").unwrap_or_default();
        if EMPTY_DOCS.contains(&doc) {
            found.push(format!(
                "{name}:{line}: the comment `{doc}` says nothing: write what the name does not say"
            ));
        }
    }
    found
}

#[test]
fn the_repository_is_written_in_the_words_of_its_field() {
    let mut texts: BTreeMap<String, String> = BTreeMap::new();
    for (folder, extensions) in [
        ("src", &["rs"][..]),
        ("shaders", &["wgsl", "md"]),
        ("tests", &["rs", "py", "md"]),
        ("benches", &["rs"]),
        ("docs", &["md"]),
        ("assets", &["toml", "md", "py"]),
    ] {
        texts.extend(source::files(folder, extensions));
    }
    for file in ["README.md", "CONTRIBUTING.md", "Cargo.toml"] {
        let text = std::fs::read_to_string(source::root().join(file));
        texts.insert(file.to_owned(), text.unwrap_or_else(|error| panic!("{file}: {error}")));
    }
    texts.remove("tests/suite/language.rs");
    let wrong: Vec<String> = texts
        .iter()
        .flat_map(|(file, text)| {
            let is_code = [".rs", ".wgsl", ".py"].iter().any(|extension| file.ends_with(extension));
            findings(file, text, is_code)
        })
        .collect();
    assert!(wrong.is_empty(), "{} words to replace:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn the_help_of_every_command_is_written_in_the_words_of_the_field() {
    let folder = support::folder();
    let help = support::run_ok(folder.path(), &["--help"]);
    let commands: Vec<&str> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| !line.is_empty())
        // Continuation lines of a wrapped description are indented further.
        .filter(|line| !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| *command != "help")
        .collect();
    assert!(commands.contains(&"dataset") && commands.len() >= 9, "{commands:?}");
    let mut texts = vec![("--help".to_owned(), help.clone())];
    for command in &commands {
        let name = format!("{command} --help");
        texts.push((name, support::run_ok(folder.path(), &[command, "--help"])));
    }
    for stage in ["nominal", "surface"] {
        let words = ["params", "--stage", stage];
        texts.push((words.join(" "), support::run_ok(folder.path(), &words)));
    }
    let wrong: Vec<String> = texts.iter().flat_map(|(name, text)| findings(name, text, true)).collect();
    assert!(wrong.is_empty(), "{} words to replace:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn banned_words_are_found_in_identifiers_and_across_lines() {
    let count = |text: &str| findings("text", text, true).len();
    assert_eq!(count("fn picture_px() -> PictureArgs { MOST_PX }"), 3);
    assert_eq!(count("// what the\n// samples show"), 1);
    assert_eq!(count("/// As above.\nfn almost_(somethings: Sifter) {}"), 1);
    assert_eq!(count("After this. Program it: of. Late."), 0);
}
