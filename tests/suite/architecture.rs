//! Who may import whom. The table is the house's rule; the sources are read and held against it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

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
    ("bench", &["dataset", "params", "scene", "render", "output", "error", "Error"]),
    ("dataset", &["params", "scene", "render", "output", "meta", "frame", "lens", "class", "error"]),
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn modules_import_only_what_they_may() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut seen = BTreeSet::new();
    for path in files {
        let below = path.strip_prefix(&root).expect("below src");
        let first = below.iter().next().expect("a name").to_string_lossy().into_owned();
        let module = first.trim_end_matches(".rs").to_owned();
        if ["lib", "main", "cli"].contains(&module.as_str()) {
            continue;
        }
        let (_, allowed) = MAY_USE
            .iter()
            .find(|(name, _)| *name == module)
            .unwrap_or_else(|| panic!("{module} has no row in the table"));
        seen.insert(module.clone());
        let text = std::fs::read_to_string(&path).expect("a source");
        let own_code = text.split("#[cfg(test)]").next().unwrap_or_default();
        for used in own_code.split("crate::").skip(1) {
            let name: String = used.chars().take_while(|c| c.is_ascii_lowercase() || *c == '_').collect();
            if name.is_empty() || name == module {
                continue; // an item that the crate's root re-exports, or its own
            }
            assert!(allowed.contains(&name.as_str()), "{} uses crate::{name}", below.display());
        }
    }
    assert_eq!(seen.len(), MAY_USE.len(), "a row of the table has no module: {seen:?}");
}

#[test]
fn only_output_touches_the_disk_and_only_the_binary_prints() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    for path in files {
        let text = std::fs::read_to_string(&path).expect("a source");
        let own_code = text.split("#[cfg(test)]").next().unwrap_or_default();
        let name = path.strip_prefix(&root).expect("below src").to_string_lossy().into_owned();
        for word in ["fs::write", "File::create", "fs::rename", "OpenOptions"] {
            assert!(!own_code.contains(word) || name == "output/disk.rs", "{name} writes files");
        }
    }
}
