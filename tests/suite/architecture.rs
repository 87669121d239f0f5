//! Who may import whom, and how long a file and a function may be. The tables are the rules; the sources are checked against
//! them.
//!
//! To add a module: its name in the row of its room in [`LAYERS`], or a row in [`MAY_USE`] for a new room.

use std::collections::BTreeMap;

use crate::support::source::{self, ImportGraph, circles, functions, import_graph};

/// Lines of a file below `src` or `shaders`, tests included.
const MAX_FILE_LINES: usize = 500;

/// Lines of a function, from `fn` to its closing brace.
const MAX_FUNCTION_LINES: usize = 80;

/// A comment line that starts so, directly above a function, allows it to be longer, and says why it is.
const LONG_BECAUSE: &str = "// Long because: ";

/// Each room (a module directly below `src`) and the rooms that it may use.
pub(crate) const MAY_USE: [(&str, &[&str]); 21] = [
    (
        "cli",
        &[
            "bench",
            "dataset",
            "doctor",
            "export",
            "gpu",
            "host_time",
            "input",
            "meta",
            "output",
            "params",
            "remap",
            "render",
            "scene",
            "frame",
            "class",
            "error",
        ],
    ),
    ("error", &[]),
    ("class", &[]),
    ("random", &[]),
    ("lens", &[]),
    ("pool", &[]),
    ("rounding", &[]),
    ("host_time", &[]),
    ("input", &["error"]),
    ("frame", &["class", "lens"]),
    ("params", &["input", "error", "random"]),
    ("scene", &["params", "random", "lens", "pool", "rounding", "class", "error"]),
    ("gpu", &["error"]),
    ("render", &["scene", "gpu", "frame", "lens", "pool", "rounding", "class", "error"]),
    ("output", &["host_time", "frame", "lens", "class", "input", "error"]),
    ("remap", &["output", "class", "input", "error"]),
    ("export", &["scene", "render", "output", "class", "error"]),
    ("meta", &["params", "scene", "render", "output", "frame", "class"]),
    ("bench", &["dataset", "host_time", "params", "scene", "render", "output", "error"]),
    (
        "doctor",
        &[
            "bench", "dataset", "params", "scene", "render", "gpu", "output", "frame", "class", "input",
            "error",
        ],
    ),
    (
        "dataset",
        &[
            "host_time",
            "params",
            "scene",
            "render",
            "output",
            "meta",
            "frame",
            "lens",
            "class",
            "input",
            "error",
        ],
    ),
];

/// The room's own file, in a row of [`LAYERS`]; it is the top layer where it is not named.
const SELF: &str = "self";

/// The modules of each room, from the bottom layer to the top one. A module may use those of lower layers only.
const LAYERS: [(&str, &[&[&str]]); 9] = [
    (
        "params",
        &[
            &["distribution", "groups", "presets"],
            &["knob_info"],
            &["knobs"],
            &["azimuth", "document"],
            &["variant"],
            &[SELF],
            &["config"],
            &["record", "variants"],
            &["listing"],
        ],
    ),
    (
        "scene",
        &[
            &[
                "azimuth",
                "flare",
                "grid_cell",
                "mesh",
                "noise",
                "nominal_craters",
                "photometry",
                "sensor",
                "size_distribution",
                "sky",
            ],
            &["ground_range", "lattice", "rings"],
            &["crater_wall", "craters", "far_hills", "fillet", "track"],
            &["grains", "crater_rays"],
            &["relief"],
            &["terrain"],
            &["bounce", "camera", "rings_mesh", "square_grid"],
            &["rocks"],
            &["label_rule", "rover"],
            &["rover_tracks"],
        ],
    ),
    (
        "gpu",
        &[
            &["machine", "memory_limits", "platform", "processor", "vendor"],
            &["device_files"],
            &["adapter", "pipeline_cache"],
            &[SELF],
            &["growing_buffer", "readback", "staging", "survey"],
            &["growing_texture", "upload"],
        ],
    ),
    (
        "render",
        &[
            &["backend", "device", "raster", "settings"],
            &["select"],
            &["lighting"],
            &["resolve", "visibility"],
            &["post", "shadow"],
            &["frame_plan"],
            &["staged_frame"],
            &["frame_packet", "scene_buffers", "slots", "tiling"],
            &["raw_frame"],
            &[SELF],
            &["fallbacks", "unwritten"],
        ],
    ),
    (
        "output",
        &[
            &["artifact", "dataset_path", "edges", "label_ids"],
            &["disk", "encode"],
            &["layout"],
            &[SELF],
            &["arrays"],
        ],
    ),
    ("export", &[&["sky", "stage"], &["gltf", "npz", "usd"]]),
    (
        "dataset",
        &[
            &["frame_image", "in_order", "work_queue"],
            &["contact_sheet", "digest", "histograms", "rules", "totals"],
            &["data_card", "plan"],
            &["attempt", "manifest"],
            &["gate", "pose"],
            &["log"],
            &["lock"],
            &["log_writer", "merge"],
            &["convert", "pipeline"],
            &["add_outputs", "frame_stream", "power_cut", "run", "verify"],
        ],
    ),
    (
        "doctor",
        &[
            &["cases", "planes"],
            &["compare", "drivers", "reference", "worker"],
            &["hardware"],
            &["findings"],
            &["examination"],
            &["markdown"],
        ],
    ),
    (
        "cli",
        &[
            &["messages", "panics"],
            &["device"],
            &["args", "child", "process", "progress"],
            &["add_outputs"],
            &["bench", "convert", "dataset", "doctor", "frame", "knobs", "remap", "stage", "verify"],
        ],
    ),
];

/// The sources of the library; `src/main.rs` is another crate, and all of it a call of `cli`.
fn library() -> BTreeMap<String, String> {
    let mut files = source::files("src", &["rs"]);
    assert!(files.remove("src/main.rs").is_some_and(|main| main.lines().count() < 50));
    files
}

/// The folder or file directly below `src` that a file belongs to.
fn top_module(file: &str) -> &str {
    let path = file.trim_start_matches("src/").trim_end_matches(".rs");
    path.split('/').next().unwrap_or(path)
}

#[test]
fn modules_import_only_what_they_may() {
    let graph = import_graph(&library());
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

/// The module of a room that a file belongs to; [`SELF`] for the room's own file.
fn module_in_room<'a>(file: &'a str, room: &str) -> Option<&'a str> {
    let path = file.strip_prefix("src/")?.strip_suffix(".rs")?;
    let below = path.strip_prefix(room)?;
    if below.is_empty() { Some(SELF) } else { below.strip_prefix('/')?.split('/').next() }
}

/// The number of the layer of a module of a room, from the bottom; `None` if it is in none.
fn layer_of(layers: &[&[&str]], module: &str) -> Option<usize> {
    let listed = layers.iter().position(|layer| layer.contains(&module));
    listed.or((module == SELF).then_some(layers.len()))
}

/// Imports in a room that do not lead to a lower layer, and modules without a layer.
fn wrong_imports(graph: &ImportGraph, room: &str, layers: &[&[&str]]) -> Vec<String> {
    let mut wrong = Vec::new();
    for (file, imports) in graph {
        let Some(module) = module_in_room(file, room) else { continue };
        let Some(layer) = layer_of(layers, module) else {
            wrong.push(format!("{file}: `{module}` is in no layer of `{room}`: add it to LAYERS"));
            continue;
        };
        for (target, import) in imports {
            let used = module_in_room(target, room).filter(|used| *used != module);
            if used.and_then(|used| layer_of(layers, used)).is_some_and(|used| used >= layer) {
                wrong.push(format!("{file}:{}: {} is not in a lower layer", import.line, import.path));
            }
        }
    }
    wrong
}

#[test]
fn modules_import_only_from_lower_layers_of_their_room() {
    let graph = import_graph(&library());
    let mut wrong = Vec::new();
    for (room, layers) in LAYERS {
        wrong.extend(wrong_imports(&graph, room, layers));
        for module in layers.iter().copied().flatten().filter(|module| **module != SELF) {
            let exists = source::root().join("src").join(room).join(format!("{module}.rs")).is_file();
            assert!(exists, "LAYERS names `{module}` in `{room}`, which does not exist");
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

/// A circle with the import of each step, one a line.
fn described(graph: &ImportGraph, circle: &[String]) -> String {
    let steps = circle.iter().zip(circle.iter().cycle().skip(1)).map(|(from, to)| {
        let import = &graph[from][to];
        format!("    {from}:{} imports {} ({to})", import.line, import.path)
    });
    format!("  circle of {}:\n{}", circle.len(), steps.collect::<Vec<_>>().join("\n"))
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let graph = import_graph(&library());
    let circles: Vec<String> = circles(&graph).iter().map(|circle| described(&graph, circle)).collect();
    assert!(circles.is_empty(), "{} import circles:\n{}", circles.len(), circles.join("\n"));
}

/// Every source and shader.
fn code_files() -> BTreeMap<String, String> {
    let mut files = source::files("src", &["rs"]);
    files.extend(source::files("shaders", &["wgsl"]));
    files
}

#[test]
fn no_file_is_too_long() {
    let mut long = Vec::new();
    for (file, text) in code_files() {
        let lines = text.lines().count();
        if lines > MAX_FILE_LINES {
            long.push(format!("{file}: {lines} lines"));
        }
    }
    assert!(long.is_empty(), "files of more than {MAX_FILE_LINES} lines:\n{}", long.join("\n"));
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
    let mut long = Vec::new();
    for (file, text) in code_files() {
        let lines: Vec<&str> = text.lines().collect();
        for function in functions(&source::without_comments_and_strings(&text)) {
            if function.lines > MAX_FUNCTION_LINES && !has_reason_above(&lines, function.line) {
                long.push(format!(
                    "{file}:{}: {} has {} lines",
                    function.line, function.name, function.lines
                ));
            }
        }
    }
    assert!(
        long.is_empty(),
        "functions of more than {MAX_FUNCTION_LINES} lines without `{LONG_BECAUSE}` above them:\n{}",
        long.join("\n")
    );
}

/// The host rasteriser knows neither the Moon nor the GPU.
#[test]
fn the_rasteriser_imports_only_rounding() {
    let graph = import_graph(&library());
    let of_rasteriser = || graph.iter().filter(|(file, _)| file.starts_with("src/render/raster"));
    assert!(of_rasteriser().count() > 5, "the rasteriser has moved");
    for (file, imports) in of_rasteriser() {
        for (target, import) in imports {
            let is_allowed = target.starts_with("src/render/raster") || target == "src/rounding.rs";
            assert!(is_allowed, "{file}:{}: the rasteriser may not use {}", import.line, import.path);
        }
    }
}

/// Where the depth aspect of a texture is discarded and its stencil stored, wgpu clears the texture in a pass of its own before the next use.
#[test]
fn no_pass_discards_its_depth() {
    for (file, text) in source::files("src", &["rs"]) {
        let code = source::without_comments_and_strings(&text);
        assert!(!code.contains("StoreOp::Discard"), "{file} discards an attachment");
    }
}

/// Names by which the standard library changes files and folders.
const WRITING: [&str; 11] = [
    "fs::write",
    "fs::rename",
    "fs::copy",
    "fs::create_dir",
    "fs::remove_",
    "fs::hard_link",
    "fs::set_permissions",
    "File::create",
    "File::options",
    "OpenOptions",
    "set_len(",
];

#[test]
fn only_output_touches_the_disk() {
    // These hold nothing but tests.
    let is_of_tests = |file: &str| file.ends_with("/tests.rs") || file == "src/dataset/power_cut.rs";
    for (file, text) in source::files("src", &["rs"]).into_iter().filter(|(file, _)| !is_of_tests(file)) {
        let code = source::without_tests(&source::without_comments_and_strings(&text));
        for word in WRITING {
            assert!(
                !code.contains(word) || file.starts_with("src/output/disk"),
                "{file} uses {word}: only output/disk may"
            );
        }
    }
}
