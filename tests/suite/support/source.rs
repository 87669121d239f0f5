//! Source files as text: comments and strings blanked, tests removed, functions and module paths found.
//!
//! These are scanners, not parsers: they know as much of Rust and WGSL as the rules of this repository need.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

/// The repository's root.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every file below `folder` (relative to the root) with one of these extensions, as `/`-separated paths from the root
/// with their text, in alphabetical order.
pub(crate) fn files(folder: &str, extensions: &[&str]) -> BTreeMap<String, String> {
    fn walk(folder: &Path, extensions: &[&str], found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                walk(&path, extensions, found);
            } else if path.extension().is_some_and(|found| extensions.iter().any(|wanted| *wanted == found)) {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    walk(&root().join(folder), extensions, &mut found);
    let named = |path: PathBuf| {
        let name = path.strip_prefix(root()).expect("below the root").to_string_lossy().replace('\\', "/");
        (name, std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
    };
    found.into_iter().map(named).collect()
}

/// The text with every comment, string and character literal replaced by spaces; line breaks stay, so that line numbers
/// do too. WGSL has no literals in quotes, so one scanner serves both languages.
pub(crate) fn without_comments_and_strings(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let mut code = String::with_capacity(text.len());
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let mut i = 0;
    while i < chars.len() {
        let start = i;
        i = match at(i) {
            '/' if at(i + 1) == '/' => (i..chars.len()).find(|&j| at(j) == '\n').unwrap_or(chars.len()),
            '/' if at(i + 1) == '*' => end_of_block_comment(&chars, i),
            '"' => end_of_string(&chars, i + 1),
            'r' if !is_word(at(i.wrapping_sub(1))) || at(i.wrapping_sub(1)) == 'b' => {
                end_of_raw_string(&chars, i).unwrap_or(i)
            }
            // A character, not a lifetime: `'a'`, `'\n'`, `'\u{1F600}'`.
            '\'' if at(i + 1) == '\\' => (i + 3..chars.len()).find(|&j| at(j) == '\'').map_or(i, |j| j + 1),
            '\'' if at(i + 2) == '\'' => i + 3,
            _ => i,
        };
        if i == start {
            code.push(at(i));
            i += 1;
        } else {
            code.extend(chars[start..i].iter().map(|c| if *c == '\n' { '\n' } else { ' ' }));
        }
    }
    code
}

fn end_of_block_comment(chars: &[char], start: usize) -> usize {
    let (mut i, mut depth) = (start + 2, 1);
    while i < chars.len() && depth > 0 {
        match chars.get(i..i + 2) {
            Some(['/', '*']) => (i, depth) = (i + 2, depth + 1),
            Some(['*', '/']) => (i, depth) = (i + 2, depth - 1),
            _ => i += 1,
        }
    }
    i
}

fn end_of_string(chars: &[char], mut i: usize) -> usize {
    while i < chars.len() && chars[i] != '"' {
        i += if chars[i] == '\\' { 2 } else { 1 };
    }
    (i + 1).min(chars.len())
}

/// The end of `r"..."` or `r#"..."#`, if one begins here.
fn end_of_raw_string(chars: &[char], start: usize) -> Option<usize> {
    let hashes = chars[start + 1..].iter().take_while(|c| **c == '#').count();
    let open = start + 1 + hashes;
    if chars.get(open) != Some(&'"') {
        return None;
    }
    let closes = |&i: &usize| {
        chars[i] == '"' && chars[i + 1..].iter().take(hashes).filter(|c| **c == '#').count() == hashes
    };
    Some((open + 1..chars.len()).find(closes).map_or(chars.len(), |i| i + 1 + hashes))
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The code with every item under `#[cfg(test)]` blanked.
pub(crate) fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut bytes = code.as_bytes().to_vec();
    let mut from = 0;
    while let Some(found) = code[from..].find(MARK) {
        let start = from + found;
        let end = end_of_item(code, start + MARK.len());
        for byte in &mut bytes[start..end] {
            if *byte != b'\n' {
                *byte = b' ';
            }
        }
        from = end;
    }
    String::from_utf8(bytes).expect("blanks are ASCII")
}

/// Where the item that begins at `start` ends: after its body or its semicolon. Attributes before it are part of it.
fn end_of_item(code: &str, start: usize) -> usize {
    let (mut nesting, mut is_use) = (0_u32, None);
    let mut word = String::new();
    for (i, c) in code[start..].char_indices() {
        if nesting == 0 && is_word(c) {
            word.push(c);
        } else if !word.is_empty() {
            is_use = is_use.or(match word.as_str() {
                "use" => Some(true),
                "pub" | "crate" | "super" => None,
                _ => Some(false),
            });
            word.clear();
        }
        match c {
            '{' | '(' | '[' => nesting += 1,
            ')' | ']' => nesting -= 1,
            '}' => {
                nesting -= 1;
                if nesting == 0 && is_use != Some(true) {
                    return start + i + 1;
                }
            }
            ';' if nesting == 0 => return start + i + 1,
            _ => (),
        }
    }
    code.len()
}

/// A function with a body.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Function {
    /// Its name, without module or type.
    pub(crate) name: String,
    /// Line of its `fn`, from 1.
    pub(crate) line: usize,
    /// Lines from its `fn` to its closing brace, both included.
    pub(crate) lines: usize,
}

/// Every function with a body in code without comments and strings, in the order of their first lines.
pub(crate) fn functions(code: &str) -> Vec<Function> {
    let mut found = Vec::new();
    for (start, _) in code.match_indices("fn ") {
        if code[..start].ends_with(is_word) {
            continue;
        }
        let name: String = code[start + 3..].trim_start().chars().take_while(|c| is_word(*c)).collect();
        let Some(open) = start_of_body(code, start) else { continue };
        if name.is_empty() {
            continue; // the type `fn (A) -> B`
        }
        let mut depth = 0;
        let end = code[open..].char_indices().find(|(_, c)| {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => (),
            }
            depth == 0
        });
        let end = open + end.map_or(0, |(i, _)| i);
        let line_of = |i: usize| 1 + code[..i].matches('\n').count();
        found.push(Function { name, line: line_of(start), lines: line_of(end) - line_of(start) + 1 });
    }
    found
}

/// The opening brace of the body of the function whose signature starts here.
fn start_of_body(code: &str, start: usize) -> Option<usize> {
    let mut depth = 0;
    for (i, c) in code[start..].char_indices() {
        match c {
            '(' | '[' => depth += 1,
            ')' | ']' => depth -= 1,
            ';' if depth == 0 => return None,
            '{' if depth == 0 => return Some(start + i),
            _ => (),
        }
        if depth < 0 {
            return None; // the type of a parameter
        }
    }
    None
}

/// Module path of a source file below its crate's root; empty for the root itself. (`src/a/b.rs` is `a::b`.)
fn module_path(file: &str) -> Vec<String> {
    let path = file.trim_start_matches("src/").trim_end_matches(".rs").trim_end_matches("/mod");
    if ["lib", "main"].contains(&path) { Vec::new() } else { path.split('/').map(str::to_owned).collect() }
}

/// An import: its line, from 1, and its path as written.
#[derive(Clone, Debug)]
pub(crate) struct Import {
    pub(crate) line: usize,
    pub(crate) path: String,
}

/// Which files import which: file to file, with the first import of each pair. Paths start from `src/`.
pub(crate) type ImportGraph = BTreeMap<String, BTreeMap<String, Import>>;

/// Modules in files of their own that a module declares under `#[cfg(test)]`.
fn test_modules(module: &[String], code: &str) -> Vec<Vec<String>> {
    let declared = code.split("#[cfg(test)]").skip(1).filter_map(|item| {
        let declaration = item.split([';', '{']).next()?;
        let name = declaration.split_whitespace().skip_while(|word| *word != "mod").nth(1)?;
        item[declaration.len()..].starts_with(';').then(|| [module, &[name.to_owned()]].concat())
    });
    declared.collect()
}

/// The graph of imports between the files of one crate, without tests. `files` are paths with their text.
pub(crate) fn import_graph(files: &BTreeMap<String, String>) -> ImportGraph {
    let code: BTreeMap<&String, String> =
        files.iter().map(|(file, text)| (file, without_comments_and_strings(text))).collect();
    let tests: BTreeSet<Vec<String>> =
        code.iter().flat_map(|(file, code)| test_modules(&module_path(file), code)).collect();
    let by_module: BTreeMap<Vec<String>, &String> = files
        .keys()
        .map(|file| (module_path(file), file))
        .filter(|(module, _)| !(1..=module.len()).any(|n| tests.contains(&module[..n])))
        .collect();
    let mut graph = ImportGraph::new();
    for (module, &file) in &by_module {
        let imports = graph.entry(file.clone()).or_default();
        let code = without_tests(&code[file]);
        for (line, path) in paths(&code) {
            let mut absolute = match path[0].as_str() {
                "crate" => Vec::new(),
                "super" => module[..module.len().saturating_sub(1)].to_vec(),
                _ => module.clone(),
            };
            let is_keyword = ["crate", "super", "self"].contains(&path[0].as_str());
            for segment in &path[usize::from(is_keyword)..] {
                match segment.as_str() {
                    "super" => drop(absolute.pop()),
                    "self" => (),
                    name => absolute.push(name.to_owned()),
                }
            }
            let target = (0..=absolute.len()).rev().find_map(|n| by_module.get(&absolute[..n]));
            if let Some(target) = target.filter(|target| **target != file) {
                imports.entry((*target).clone()).or_insert(Import { line, path: path.join("::") });
            }
        }
    }
    graph
}

/// Every path in the code that can name a module of the crate: those that start with `crate`, `super` or `self`, and those
/// that start with a module which the file declares. A group is one path for each of its members.
fn paths(code: &str) -> Vec<(usize, Vec<String>)> {
    let tokens = tokens(code);
    let text = |i: usize| tokens.get(i).map_or("", |token| token.1);
    let declared: BTreeSet<&str> =
        (1..tokens.len()).filter(|&i| text(i - 1) == "mod" && text(i + 1) == ";").map(text).collect();
    let mut found = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        let starts = ["crate", "super", "self"].contains(&text(i)) || declared.contains(text(i));
        let continues = i > 0 && ["::", "."].contains(&text(i - 1));
        // `pub(in crate::render)` is a visibility.
        let is_visibility = i > 1 && text(i - 1) == "in" && text(i - 2) == "(";
        if starts && !continues && !is_visibility && text(i + 1) == "::" {
            i = path_from(&tokens, i, &mut Vec::new(), &mut found);
        } else {
            i += 1;
        }
    }
    found
}

/// Reads a path, or a member of a group, from token `i` on; returns the token behind it.
fn path_from(
    tokens: &[(usize, &str)],
    mut i: usize,
    prefix: &mut Vec<String>,
    found: &mut Vec<(usize, Vec<String>)>,
) -> usize {
    let text = |i: usize| tokens.get(i).map_or("", |token| token.1);
    let (line, depth) = (tokens[i].0, prefix.len());
    loop {
        if text(i) == "{" {
            i += 1;
            while i < tokens.len() && text(i) != "}" {
                i = if text(i) == "," { i + 1 } else { path_from(tokens, i, prefix, found) };
            }
            prefix.truncate(depth);
            return i + 1;
        }
        if text(i).starts_with(is_word) {
            prefix.push(text(i).to_owned());
        }
        i += 1;
        if text(i) != "::" {
            break;
        }
        i += 1;
    }
    found.push((line, prefix.clone()));
    prefix.truncate(depth);
    while text(i) == "as" {
        i += 2;
    }
    i
}

/// Words and punctuation of the code, each with its line; `::` is one token.
fn tokens(code: &str) -> Vec<(usize, &str)> {
    let mut tokens = Vec::new();
    let (mut line, mut i) = (1, 0);
    while let Some(c) = code[i..].chars().next() {
        let rest = &code[i..];
        let length = if is_word(c) {
            rest.find(|c| !is_word(c)).unwrap_or(rest.len())
        } else if rest.starts_with("::") {
            2
        } else {
            c.len_utf8()
        };
        if c == '\n' {
            line += 1;
        } else if !c.is_whitespace() {
            tokens.push((line, &code[i..i + length]));
        }
        i += length;
    }
    tokens
}

/// The shortest circle of imports through each file that is in one, as the files in their order; each circle once.
pub(crate) fn circles(graph: &ImportGraph) -> Vec<Vec<String>> {
    let mut found: BTreeMap<BTreeSet<String>, Vec<String>> = BTreeMap::new();
    for start in graph.keys() {
        let mut came_from: BTreeMap<&String, &String> = BTreeMap::new();
        let mut queue = VecDeque::from([start]);
        'search: while let Some(file) = queue.pop_front() {
            for next in graph.get(file).into_iter().flat_map(BTreeMap::keys) {
                if next == start {
                    let mut circle = vec![file.clone()];
                    let mut last = file;
                    while let Some(before) = came_from.get(last) {
                        circle.push((*before).clone());
                        last = before;
                    }
                    circle.reverse();
                    found.entry(circle.iter().cloned().collect()).or_insert(circle);
                    break 'search;
                }
                if !came_from.contains_key(next) {
                    came_from.insert(next, file);
                    queue.push_back(next);
                }
            }
        }
    }
    found.into_values().collect()
}

#[test]
fn comments_and_strings_are_blanked_and_lines_stay() {
    let text = "a // b\n\"c \\\" // d\" e /* f /* g */\nh */ i 'j' &'k l r#\"m\" n\"# o b\"p\" '\\'' q";
    let code = without_comments_and_strings(text);
    assert_eq!(code.matches('\n').count(), 2);
    assert_eq!(code.split_whitespace().collect::<Vec<_>>(), ["a", "e", "i", "&'k", "l", "o", "b", "q"]);
}

#[test]
fn items_of_tests_are_blanked_up_to_their_end() {
    let code = "#[cfg(test)]\nuse a::{b, c};\nfn d() {}\n#[cfg(test)]\n#[allow(x(y))]\nmod tests { fn e() {} }\nfn f() {}";
    let left = without_tests(code);
    assert_eq!(left.split_whitespace().collect::<Vec<_>>(), ["fn", "d()", "{}", "fn", "f()", "{}"]);
}

#[test]
fn functions_are_measured_from_fn_to_brace() {
    let code = "fn a(x: fn(u8) -> u8) -> [u8; 2]\n{\n if x { y }\n}\ntrait T { fn b(); fn c() { } }";
    let named = |name: &str, line, lines| Function { name: name.to_owned(), line, lines };
    assert_eq!(functions(code), [named("a", 1, 4), named("c", 5, 1)]);
}

#[test]
fn imports_are_resolved_to_files_and_circles_are_found() {
    let files = [
        ("src/lib.rs", "pub mod a; pub mod b; pub use b::X;"),
        ("src/a.rs", "mod c; use crate::b::{self, X, Y as Z}; fn f() { c::g() }"),
        ("src/a/c.rs", "pub(in crate::a) fn g() { super::super::b::h(\"crate::b\") } // crate::lib"),
        (
            "src/b.rs",
            "#[cfg(test)] use crate::a; pub struct X; use crate::a::c::{d::E, *};\n#[cfg(test)]\nmod t;",
        ),
        ("src/b/t.rs", "use super::X;"),
    ];
    let files = files.map(|(name, text)| (name.to_owned(), text.to_owned())).into();
    let graph = import_graph(&files);
    let of = |file: &str| graph[file].keys().map(String::as_str).collect::<Vec<_>>();
    assert_eq!(of("src/lib.rs"), ["src/b.rs"]);
    assert_eq!(of("src/a.rs"), ["src/a/c.rs", "src/b.rs"]);
    assert_eq!(of("src/a/c.rs"), ["src/b.rs"]);
    assert_eq!(of("src/b.rs"), ["src/a/c.rs"]);
    assert!(!graph.contains_key("src/b/t.rs"), "a module of tests");
    assert_eq!(circles(&graph), [["src/a/c.rs", "src/b.rs"]]);
}
