//! The command line, run as a process: the files it writes, and its messages on wrong input.

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Stdio};

use regolith::scene::rocks::Rock;

use crate::support::{
    adapter_below_file_limit, adapter_name, folder, json, missing_gl, npy, program, run, run_ok,
    run_with_file_limit, scene,
};

/// Runs a command that must fail with this status, name all of `expected` in its message, and leave the folder unchanged.
fn assert_refused(words: &[&str], status: i32, expected: &[&str]) {
    let folder = folder();
    std::fs::write(folder.path().join("a_file"), "not a folder").expect("written");
    std::fs::write(folder.path().join("broken.toml"), "[sun]\nelevation_deg = = 3\n").expect("written");
    std::fs::write(folder.path().join("typo.toml"), "[sun]\nelevation_dg = 3\n").expect("written");
    std::fs::write(folder.path().join("seed.toml"), "seed = 3\n").expect("written");
    let output = run(folder.path(), words);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{words:?}: {message}");
    for text in expected {
        assert!(message.contains(text), "{words:?} should mention `{text}`:\n{message}");
    }
    assert!(!message.contains("panicked") && !message.contains("backtrace"), "{message}");
    assert!(output.stdout.is_empty(), "{words:?} printed a result");
    let mut left: Vec<_> =
        std::fs::read_dir(folder.path()).expect("read").map(|e| e.expect("an entry").file_name()).collect();
    left.sort();
    assert_eq!(left, ["a_file", "broken.toml", "seed.toml", "typo.toml"], "{words:?} wrote something");
}

#[test]
fn the_pipeline_cache_is_stored_and_changes_no_image() {
    let folder = folder();
    let render = |caches: &Path| {
        let words = ["--seed", "3", "--size", "64", "--force"];
        let output = program(folder.path()).args(words).env("XDG_CACHE_HOME", caches).output();
        let output = output.expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        std::fs::read(folder.path().join("out/rgb_0000.png")).expect("an image")
    };
    let cache_file = || {
        let cache = folder.path().join("caches/regolith-render");
        let mut files = std::fs::read_dir(cache).expect("a folder").map(|file| file.expect("a file").path());
        let file = files.next().expect("the cache of the driver");
        assert!(files.next().is_none(), "one file for one driver");
        file
    };
    let caches = folder.path().join("caches");
    let first = render(&caches);
    let complete = std::fs::read(cache_file()).expect("the cache");
    assert!(first == render(&caches), "with a stored cache");
    let damaged = &complete[..complete.len() / 2];
    std::fs::write(cache_file(), damaged).expect("written");
    assert!(first == render(&caches), "with a damaged cache");
    let replaced = std::fs::read(cache_file()).expect("the cache").len();
    assert!(replaced > damaged.len(), "a damaged cache is replaced");
    assert!(first == render(&folder.path().join("out/rgb_0000.png")), "where no cache can be stored");
}

#[test]
fn a_wrong_setting_is_refused_with_name_value_and_remedy() {
    for (words, expected) in [
        (
            &["--set", "sun.elevaton_deg=3"][..],
            &["unknown knob `sun.elevaton_deg`", "did you mean `sun.elevation_deg`"][..],
        ),
        (&["--set", "sun.elevation_deg=95"], &["sun.elevation_deg = 95", "0.5 to 90 deg"]),
        (&["--set", "sun.elevation_deg=nan"], &["sun.elevation_deg = nan", "finite", "0.5 to 90 deg"]),
        (&["--set", "rocks.count=-1"], &["rocks.count = -1", "whole numbers, 0 to 5000"]),
        (&["--set", "rocks.count=1.5"], &["a whole number", "allowed: whole numbers, 0 to 5000"]),
        (&["--set", "sun.elevation_deg=low"], &["expected a number", "allowed: 0.5 to 90 deg"]),
        (&["--stage", "surfac"], &["did you mean `surface`"]),
        (&["--set", "sun.elevation_deg"], &["KEY=VALUE"]),
        (&["--set", "camera.x_m=700"], &["contradict", "camera.x_m = 700", "terrain.size_m"]),
        (&["--size", "0"], &["--size 0x0", "at least one pixel"]),
        (&["--size", "512x0"], &["--size 512x0"]),
        (&["--size", "big"], &["'big' for '--size", "WxH or N"]),
        (&["--size", "-5"], &["'-5' for '--size", "WxH or N"]),
        (&["--seed", "-1"], &["'-1' for '--seed", "from 0 to 18446744073709551615"]),
        (
            &["--stage", "nominal", "--preset", "surface_train_dr"],
            &["contradict", "--stage nominal", "surface"],
        ),
        (&["--out", "-"], &["--out -", "webdataset"]),
        (
            &["--set", "camera.height_m=59", "--set", "sky.dome_radius_m=60"],
            &["camera.height_m = 59", "dome_radius_m"],
        ),
        (&["--size", "16x2000"], &["16 x 2000 pixels", "camera.height_m"]),
        (&["--size", "64x160", "--set", "camera.k1=-0.1"], &["camera.k1 = -0.1", "64 x 160 pixels"]),
        (&["--config", "seed.toml"], &["`seed` in seed.toml", "--seed"]),
        (&["--set", "sun=5"], &["`sun` in --set is a group and no knob"]),
        (
            &["--set", "rules.lit_mn=0"],
            &["unknown rule `rules.lit_mn` in --set", "`rules.lit_min`", "params rules"],
        ),
        (&["--size", "100000"], &["100000x100000", "200000 samples along a side", "smaller --size"]),
        (&["--samples", "3"], &["--samples 3", "1, 4 (2 x 2) and 16"]),
        (&["--preset", "referense"], &["unknown preset `referense`", "did you mean `reference`", "train_dr"]),
        (&["--preset", "train_dr, "], &["--preset 'train_dr, '", "a name in the list is empty"]),
        (&["--stage", "mars"], &["stage.name = \"mars\"", "nominal"]),
        (&["--config", "broken.toml"], &["broken.toml, line 2, column 17"]),
        (&["--config", "typo.toml"], &["sun.elevation_dg", "typo.toml", "did you mean `sun.elevation_deg`"]),
        (&["--config", "missing.toml"], &["cannot read missing.toml"]),
        (&["--outputs", "rgb,masks"], &["unknown output `masks`", "did you mean `mask`"]),
        (&["--out", "a_file"], &["--out a_file is a file"]),
        (&["dataset", "--count=1", "--out=a_file/data"], &["--out a_file is a file", "name a folder"]),
        (&["dataset", "--out=data"], &["--count <N>", "--split <LIST>", "--merge", "--add-outputs <LIST>"]),
        (&["verify", "nowhere"], &["nowhere: there is no such folder"]),
        (&["convert", "nowhere", "--format=coco"], &["nowhere: there is no such folder"]),
        (&["dataset", "--merge", "--out=nowhere"], &["nowhere: there is no such folder"]),
        (&["dataset", "--add-outputs=depth", "nowhere"], &["nowhere: there is no such folder"]),
        (&["--out", "/dev/null"], &["--out /dev/null is a file"]),
        (&["--out", "."], &["already holds a_file", "--force"]),
        (&["--adapter", "voodoo"], &["no adapter matches `voodoo`", &adapter_name()]),
        (&["--seed=-1"], &["--seed"]),
        (&["--seeds", "1"], &["--seed"]),
        (&["--edges", "ignore:0"], &["--edges ignore:0", "ignore:N"]),
        (&["--label-ids", "mine"], &["canonical", "replicator"]),
    ] {
        assert_refused(words, 2, expected);
    }
}

#[test]
fn without_an_adapter_the_message_says_how_to_install_one() {
    for (backend, packages) in [
        ("vulkan", "apt-get install mesa-vulkan-drivers`"),
        ("gl", "apt-get install libegl1 libgl1-mesa-dri`"),
    ] {
        let folder = folder();
        let output = program(folder.path())
            .env("VK_DRIVER_FILES", "/nonexistent.json")
            .env("VK_ICD_FILENAMES", "/nonexistent.json")
            .env("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent.json")
            .env("WGPU_BACKEND", backend)
            .output()
            .expect("the program starts");
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        let tried = format!("no graphics adapter was found; tried: {backend} (WGPU_BACKEND allows no other)");
        assert!(message.contains(&tried) && message.contains(packages), "{message}");
        assert!(!folder.path().join("out").exists());
    }
}

#[test]
fn an_unknown_backend_is_an_error_and_an_empty_one_means_any() {
    let folder = folder();
    let adapters = |backend| program(folder.path()).arg("adapters").env("WGPU_BACKEND", backend).output();
    let any = adapters("").expect("the program starts");
    assert!(any.status.success() && String::from_utf8_lossy(&any.stdout).contains("vulkan"));
    let wrong = adapters("vulcan").expect("the program starts");
    let message = String::from_utf8_lossy(&wrong.stderr);
    assert_eq!(wrong.status.code(), Some(2), "{message}");
    assert!(message.contains("unknown backend `vulcan`; the backends are vulkan and gl"), "{message}");
}

#[test]
fn messages_that_cannot_be_written_do_not_stop_a_run() {
    let folder = folder();
    let status = |words: &[&str]| {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("a device that is full");
        program(folder.path()).args(words).stderr(full).output().expect("the program starts").status.code()
    };
    assert_eq!(status(&["--size", "32", "-v"]), Some(0));
    assert_eq!(status(&["dataset", "--count", "2", "--size", "32", "--out", "data"]), Some(0));
    assert_eq!(status(&["--set", "sun.elevation_deg=95"]), Some(2));
}

#[test]
fn help_that_cannot_be_written_is_an_error() {
    let folder = folder();
    for words in [&["--help"][..], &["--version"], &["help", "dataset"], &["bench", "-h"], &["presets"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("a device that is full");
        let output = program(folder.path()).args(words).stdout(full).output().expect("the program starts");
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{words:?}: {message}");
        assert!(message.starts_with("error: cannot write to standard output: "), "{words:?}: {message}");
        run_ok(folder.path(), words);
    }
}

#[test]
fn a_frame_reports_files_of_an_earlier_run_and_broken_rules() {
    let folder = folder();
    let rule = "--set=require={rock=[0.9,1]}";
    let messages = |words: &[&str]| {
        let output = run(folder.path(), words);
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let first = messages(&["--size", "32", "--outputs", "rgb,depth"]);
    assert!(!first.contains("earlier run") && !first.contains("again"), "{first}");
    let second = messages(&["--size", "48", "--outputs", "rgb", rule]);
    assert!(
        second.contains("files of an earlier run") && second.contains("distance_to_camera_0000.npy"),
        "{second}"
    );
    assert!(second.contains("a dataset would redraw this frame: rock covers"), "{second}");
}

#[test]
fn a_device_lost_during_a_frame_is_an_error_and_leaves_no_files() {
    let folder = folder();
    let output =
        program(folder.path()).env("REGOLITH_FAULT", "device-lost").output().expect("the program starts");
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("device was lost") && message.contains("nothing of this frame"), "{message}");
    assert!(!message.contains("panicked") && !message.contains("bug in"), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    assert!(!folder.path().join("out").exists());
}

/// Tests may run as root, who may write to a read-only folder, so these are paths where nobody can create a folder.
#[test]
fn an_output_folder_that_cannot_be_created_is_an_error() {
    let folder = folder();
    for out in ["/proc/regolith", "/dev/null/out"] {
        let output = run(folder.path(), &["--size", "16", "--out", out]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains(&format!("cannot write {out}")), "{message}");
    }
}

/// A file size limit makes writes fail in the middle of a file, like a full disk.
#[test]
fn a_full_disk_leaves_no_partial_file() {
    let folder = folder();
    let words = [&["--seed", "3", "--out", "out", "--quiet"], &adapter_below_file_limit()[..]].concat();
    let output = run_with_file_limit(folder.path(), (8, "trap '' XFSZ;"), &words);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("cannot write out/"), "{message}");
    assert!(!folder.path().join("out").exists(), "nothing is left");
}

#[test]
fn one_frame_is_five_files_with_the_documented_names_and_keys() {
    let folder = folder();
    let printed = run_ok(folder.path(), &["--seed", "7", "--size", "200x120"]);
    let expected = [
        "out/rgb_0000.png",
        "out/semantic_segmentation_0000.png",
        "out/semantic_segmentation_labels_0000.json",
        "out/preview_0000.png",
        "out/frame_0000.json",
    ];
    assert_eq!(printed.lines().collect::<Vec<_>>(), expected);
    for name in expected {
        let file = std::fs::metadata(folder.path().join(name)).expect("a file");
        assert_eq!(file.permissions().mode() & 0o600, 0o600);
        assert_eq!(file.permissions().mode() & 0o044, 0o044, "others may read {name}");
    }
    let mask = image::open(folder.path().join(expected[1])).expect("a mask");
    assert_eq!((mask.width(), mask.height(), mask.color()), (200, 120, image::ColorType::L8));
    let rgb = image::open(folder.path().join(expected[0])).expect("an image");
    assert_eq!((rgb.width(), rgb.height(), rgb.color()), (200, 120, image::ColorType::Rgb8));

    let meta = json(&folder.path().join("out/frame_0000.json"));
    assert_eq!((&meta["seed"], &meta["stage"], &meta["samples"]), (&7.into(), &"nominal".into(), &4.into()));
    assert_eq!(meta["size"], serde_json::json!([200, 120]));
    let nominal = regolith::params::KNOBS.iter().filter(|info| info.is_of(regolith::params::Stage::Nominal));
    assert_eq!(meta["knobs"].as_object().map(serde_json::Map::len), Some(nominal.count()));
    assert!((75..=114).contains(&meta["knobs"]["rocks.count"].as_u64().expect("a count")));
    let ids = mask.into_luma8();
    for (class, id) in [("regolith", 0), ("rock", 1), ("sky", 2), ("unlabelled", 255)] {
        let share = ids.iter().filter(|value| **value == id).count() as f64 / 24_000.0;
        assert!((meta["coverage"][class].as_f64().expect("a fraction") - share).abs() < 1e-9);
    }
    for stage in ["scene", "pipelines", "upload", "shadow", "lighting", "readback", "encode"] {
        assert!(meta["ms"][stage].is_f64(), "{stage} in {}", meta["ms"]);
    }
    for key in ["fx", "fy", "cx", "cy", "K", "world_from_camera", "world_from_camera_gl", "near_m", "far_m"] {
        assert!(!meta["camera"][key].is_null(), "camera.{key}");
    }
    assert_eq!(meta["camera"]["cx"], 100.0);
    assert!((meta["camera"]["near_m"].as_f64().expect("metres") - 0.05).abs() < 1e-6);
    assert!(meta["camera"]["far_m"].as_f64() > meta["knobs"]["sky.dome_radius_m"].as_f64());
    assert_eq!(meta["moved_rocks"], serde_json::json!([]));
    assert_eq!(meta["geometry_hash"].as_str().map(str::len), Some(32));
    assert_eq!(meta["adapter"]["name"], adapter_name());
}

/// A rock that would stand nearer than half a metre from the eye is moved, and the record says so.
#[test]
fn a_rock_too_near_to_the_eye_is_moved_and_recorded() {
    let folder = folder();
    let among_rocks = "camera.y_m=-60";
    run_ok(folder.path(), &["--seed", "5", "--size", "32", "--outputs", "meta", "--set", among_rocks]);
    let meta = json(&folder.path().join("out/frame_0000.json"));
    assert_eq!(meta["moved_rocks"], serde_json::json!([1]));
    let on_surface =
        ["stage.name=surface", "rocks.coverage=0.1", "camera.pitch_deg=-80", "camera.height_m=0.6"];
    for (seed, set) in [(5, &[among_rocks][..]), (5, &on_surface), (6, &on_surface), (7, &on_surface)] {
        let scene = scene(seed, set);
        let of_rock = |rock: &Rock| {
            let vertices = rock.vertices.iter().map(|vertex| vertex.position + rock.centre);
            vertices.map(|at| at.distance(scene.camera.eye)).fold(f32::INFINITY, f32::min)
        };
        let nearest_m = scene.rocks.iter().map(of_rock).fold(f32::INFINITY, f32::min);
        assert!((0.5..1.5).contains(&nearest_m), "seed {seed}, {set:?}: a rock is {nearest_m} m away");
    }
}

/// Scripts rely on these names.
#[test]
fn knobs_of_scripts_have_their_names() {
    let names = "sun.elevation_deg sun.azimuth_deg sun.intensity sun.angular_diameter_deg sun.color \
        terrain.amplitude_m terrain.size_m terrain.cells regolith.albedo regolith.roughness craters.count craters.radius_m \
        craters.depth_m craters.rim_ratio rocks.count rocks.near_count rocks.scale_m rocks.near_scale_m rocks.near_y_m \
        rocks.embedding rocks.albedo rocks.roughness rocks.displacement camera.x_m camera.y_m camera.height_m \
        camera.pitch_deg camera.yaw_deg camera.roll_deg camera.fov_deg camera.exposure_ev sky.star_count sky.dome_radius_m";
    for name in names.split_whitespace() {
        let is_known = regolith::params::KNOBS.iter().any(|info| info.name == name);
        assert!(is_known, "no knob {name}");
    }
}

/// A world point, projected with the recorded K and pose, falls on the pixel where it is drawn.
#[test]
fn the_recorded_camera_projects_the_horizon_to_its_row() {
    let folder = folder();
    let words = [
        "--size",
        "256",
        "--set",
        "rocks.count=0",
        "--set",
        "terrain.amplitude_m=0",
        "--set",
        "craters.count=0",
    ];
    run_ok(folder.path(), &[&words[..], &["--set", "camera.pitch_deg=-10"]].concat());
    let meta = json(&folder.path().join("out/frame_0000.json"));
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let (fy, cy) = (number(&meta["camera"]["fy"]), number(&meta["camera"]["cy"]));
    // The far edge of flat ground 2 m below the eye, 550 m ahead.
    let pose = &meta["camera"]["world_from_camera"];
    let axis = |row: usize, column: usize| number(&pose[row][column]);
    let offset = [0.0 - axis(0, 3), 460.0 - axis(1, 3), 0.0 - axis(2, 3)];
    let along = |column: usize| (0..3).map(|row| axis(row, column) * offset[row]).sum::<f64>();
    let v = cy + fy * along(1) / along(2);
    let mask =
        image::open(folder.path().join("out/semantic_segmentation_0000.png")).expect("a mask").into_luma8();
    let first_ground = (0..256).find(|y| mask.get_pixel(128, *y).0 == [0]).expect("ground");
    assert!((f64::from(first_ground) - v).abs() <= 1.0, "drawn at row {first_ground}, projected to {v}");
}

#[test]
fn only_the_chosen_outputs_are_written_and_replicator_ids_are_used() {
    let folder = folder();
    run_ok(folder.path(), &["--size", "64", "--outputs", "mask", "--label-ids", "replicator"]);
    let mut names: Vec<_> = std::fs::read_dir(folder.path().join("out"))
        .expect("read")
        .map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["semantic_segmentation_0000.png", "semantic_segmentation_labels_0000.json"]);
    let labels = json(&folder.path().join("out/semantic_segmentation_labels_0000.json"));
    assert_eq!(labels["4"]["class"], "regolith");
    let mask = image::open(folder.path().join("out").join(&names[0])).expect("a mask").into_luma8();
    assert!(mask.iter().all(|id| [2, 3, 4].contains(id)));
}

#[test]
fn set_wins_over_config_over_preset_over_defaults() {
    let folder = folder();
    std::fs::write(folder.path().join("my.toml"), "[sun]\nelevation_deg = 33\nazimuth_deg = 44\n")
        .expect("written");
    let words =
        ["params", "--preset", "train_nodr", "--config", "my.toml", "--set", "sun.azimuth_deg=55", "--json"];
    let rows: serde_json::Value = serde_json::from_str(&run_ok(folder.path(), &words)).expect("JSON");
    let value = |name: &str| {
        let rows = rows.as_array().expect("rows");
        rows.iter().find(|row| row["name"] == name).expect("a knob")["value"].clone()
    };
    assert_eq!(value("sun.azimuth_deg"), 55.0);
    assert_eq!(value("sun.elevation_deg"), 33.0);
    assert_eq!(value("regolith.albedo"), 0.18);
    assert_eq!(value("sky.dome_radius_m"), 600.0);
}

#[test]
fn the_output_of_params_is_a_config() {
    let folder = folder();
    let listing = run_ok(folder.path(), &["params", "--preset", "train_dr"]);
    std::fs::write(folder.path().join("my.toml"), listing).expect("written");
    run_ok(folder.path(), &["--config", "my.toml", "--size", "32", "--out", "a"]);
    run_ok(folder.path(), &["--preset", "train_dr", "--size", "32", "--out", "b"]);
    let read = |out: &str| std::fs::read(folder.path().join(out).join("rgb_0000.png")).expect("an image");
    assert!(read("a") == read("b"));
    let listing = std::fs::File::open(folder.path().join("my.toml")).expect("the file");
    let piped =
        program(folder.path()).args(["--config", "-", "--size", "32", "--out", "c"]).stdin(listing).output();
    assert!(piped.expect("the program starts").status.success() && read("c") == read("a"));
}

#[test]
fn results_go_to_stdout_and_messages_to_stderr_without_noise() {
    let folder = folder();
    let adapters: serde_json::Value =
        serde_json::from_str(&run_ok(folder.path(), &["adapters", "--json"])).expect("JSON");
    assert!(adapters.as_array().is_some_and(|rows| rows.iter().any(|row| row["name"] == adapter_name())));
    let quiet = program(folder.path())
        .args(["--size", "32", "-q"])
        .env_remove("XDG_RUNTIME_DIR")
        .output()
        .expect("run");
    assert!(quiet.status.success() && quiet.stderr.is_empty(), "{}", String::from_utf8_lossy(&quiet.stderr));
    let json_run = run_ok(folder.path(), &["--size", "32", "--json"]);
    let record: serde_json::Value = serde_json::from_str(&json_run).expect("JSON");
    assert_eq!(record["frame"]["seed"], 42);
    assert!(run_ok(folder.path(), &["completions", "bash"]).contains("regolith-render"));
    assert!(run_ok(folder.path(), &["--help"]).contains("--preset reference"));
}

/// GL through EGL draws the same frame as Vulkan: the same classes except for a few pixels on outlines.
#[test]
fn gl_agrees_with_vulkan() {
    let folder = folder();
    if let [missing, ..] = &missing_gl()[..] {
        let refused = program(folder.path()).args(["--size", "32"]).env("WGPU_BACKEND", "gl").output();
        let refused = refused.expect("the program starts");
        let message = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success() && message.contains(missing), "{message}");
        return;
    }
    let frame = |backend: &str| {
        let output = program(folder.path())
            .args(["--seed", "5", "--size", "256", "--out", backend])
            .env("WGPU_BACKEND", backend)
            .output()
            .expect("the program starts");
        assert!(output.status.success(), "{backend}: {}", String::from_utf8_lossy(&output.stderr));
        let open = |name: &str| image::open(folder.path().join(backend).join(name)).expect("an image");
        let meta = json(&folder.path().join(backend).join("frame_0000.json"));
        let used = meta["adapter"]["backend"].as_str().unwrap_or_default().to_lowercase();
        assert_eq!(used, backend, "the requested backend");
        (open("rgb_0000.png").into_rgb8(), open("semantic_segmentation_0000.png").into_luma8())
    };
    let (vulkan, gl) = (frame("vulkan"), frame("gl"));
    let different = vulkan.1.iter().zip(gl.1.iter()).filter(|(a, b)| a != b).count();
    assert!(different <= 65, "{different} pixels of 65536 have another class");
    let sum: u64 = vulkan.0.iter().zip(gl.0.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    let mean = sum as f64 / (3.0 * 65_536.0);
    assert!(mean < 0.5, "mean difference {mean}");
}

#[test]
fn a_folder_with_other_content_needs_force() {
    let folder = folder();
    let out = folder.path().join("out");
    std::fs::create_dir(&out).expect("a folder");
    std::fs::write(out.join("notes.txt"), "mine").expect("written");
    let refused = run(folder.path(), &["--size", "16"]);
    assert_eq!(refused.status.code(), Some(2));
    run_ok(folder.path(), &["--size", "16", "--force"]);
    run_ok(folder.path(), &["--size", "16", "--force"]);
    assert!(Path::exists(&out.join("notes.txt")) && Path::exists(&out.join("rgb_0000.png")));
}

/// Depth, K and pose from the files reproject every pixel of flat ground onto it, and both kinds of distance agree.
#[test]
fn depth_reprojects_to_the_world_through_k_and_pose() {
    let folder = folder();
    let flat = ["--set", "terrain.amplitude_m=0", "--set", "craters.count=0", "--set", "rocks.count=0"];
    let camera =
        ["--set", "camera.pitch_deg=-12", "--set", "camera.yaw_deg=30", "--set", "camera.roll_deg=7"];
    let rest = ["--size", "160x120", "--outputs", "mask,depth,normals,meta"];
    run_ok(folder.path(), &[&flat[..], &camera, &rest].concat());
    let out = folder.path().join("out");
    let meta = json(&out.join("frame_0000.json"));
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let camera = &meta["camera"];
    let (f, cx, cy) = (number(&camera["fx"]), number(&camera["cx"]), number(&camera["cy"]));
    let pose = |row: usize, column: usize| number(&camera["world_from_camera"][row][column]);
    let (depth, distance) =
        (npy(&out.join("distance_to_image_plane_0000.npy")), npy(&out.join("distance_to_camera_0000.npy")));
    let normals = npy(&out.join("normals_0000.npy"));
    let mask = image::open(out.join("semantic_segmentation_0000.png")).expect("a mask").into_luma8();
    let mut checked = 0;
    for (x, y, id) in mask.enumerate_pixels() {
        let pixel = (y * 160 + x) as usize;
        if id.0 == [2] {
            assert!(
                depth[pixel].is_infinite() && distance[pixel].is_infinite() && normals[3 * pixel + 2] == 0.0
            );
            continue;
        }
        let (u, v) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let ray = [(u - cx) / f, (v - cy) / f, 1.0];
        let z = f64::from(depth[pixel]);
        let height = pose(2, 3) + z * (0..3).map(|i| pose(2, i) * ray[i]).sum::<f64>();
        let length = z * ray.iter().map(|r| r * r).sum::<f64>().sqrt();
        assert!((f64::from(distance[pixel]) / length - 1.0).abs() < 1e-5);
        assert!((normals[3 * pixel + 2] - 1.0).abs() < 1e-3);
        // Pixels on the horizon have their depth from only some of their samples.
        if y > 0 && mask.get_pixel(x, y - 1).0 == [0] && x > 0 && mask.get_pixel(x - 1, y).0 == [0] {
            assert!(height.abs() < 1e-4 * z, "pixel {x}, {y} lies {height} m off the ground, {z} m away");
            checked += 1;
        }
    }
    assert!(checked > 5000, "{checked}");
}

#[test]
fn every_output_is_written_and_agrees_with_the_mask() {
    let folder = folder();
    let words = ["--seed", "42", "--size", "160", "--outputs", "all", "--edges", "ignore:2"];
    let printed = run_ok(folder.path(), &words);
    assert_eq!(printed.lines().count(), 22, "{printed}");
    let out = folder.path().join("out");
    let open = |name: &str| image::open(out.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    let mask = open("semantic_segmentation_0000.png").into_luma8();
    let instances = open("instance_segmentation_0000.png").into_luma16();
    let mapping = json(&out.join("instance_segmentation_mapping_0000.json"));
    let coverage = npy(&out.join("semantic_coverage_0000.npy"));
    let meta = json(&out.join("frame_0000.json"));
    assert_eq!(meta["edges"], "ignore:2");
    assert_eq!(
        meta["coverage"]["unlabelled"], 0.0,
        "the edge policy applies to the mask, not to the coverage of the scene"
    );
    let mut ignored = 0;
    for (pixel, (id, instance)) in mask.iter().zip(instances.iter()).enumerate() {
        let shares = &coverage[3 * pixel..3 * pixel + 3];
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        ignored += u32::from(*id == 255);
        let max = shares.iter().copied().fold(0.0, f32::max);
        assert!(
            *id == 255 || shares[usize::from(*id)] == max,
            "a pixel has the majority class of its samples"
        );
        assert!(*id == 255 || (*id == 1) == (*instance > 0));
        assert!(
            *instance == 0 || !mapping[instance.to_string()].is_null(),
            "instance {instance} is in the mapping"
        );
    }
    assert!(ignored > 300, "{ignored}");
    for (id, rock) in mapping.as_object().expect("an object") {
        let number: u16 = id.parse().expect("an id");
        assert_eq!(rock["path"], format!("/World/Rocks/Rock_{:03}", number - 1));
        let pixels: Vec<(u32, u32)> = instances
            .enumerate_pixels()
            .filter(|(.., id)| id.0 == [number])
            .map(|(x, y, _)| (x, y))
            .collect();
        assert_eq!(rock["visible_px"], pixels.len());
        let bound = |pick: fn(&(u32, u32)) -> u32| {
            (pixels.iter().map(pick).min().expect("pixels"), pixels.iter().map(pick).max().expect("pixels"))
        };
        let ((left, right), (top, bottom)) = (bound(|p| p.0), bound(|p| p.1));
        assert_eq!(rock["box_px"], serde_json::json!([left, top, right, bottom]));
        assert!((0.0..1.0).contains(&rock["occluded"].as_f64().expect("a fraction")));
    }
    let occluded = |value: f64| {
        mapping.as_object().is_some_and(|rocks| {
            rocks.values().any(|rock| (rock["occluded"].as_f64().expect("a fraction") - 0.5).abs() < value)
        })
    };
    assert!(occluded(0.45), "some rock is partly behind another");
    assert_eq!(open("shadow_0000.png").color(), image::ColorType::L8);
}

/// Additional outputs change neither colour nor mask.
#[test]
fn annotations_change_neither_image_nor_mask() {
    let folder = folder();
    run_ok(folder.path(), &["--size", "128", "--outputs", "all", "--out", "all"]);
    run_ok(folder.path(), &["--size", "128", "--out", "plain"]);
    for name in ["rgb_0000.png", "semantic_segmentation_0000.png"] {
        let read = |out: &str| std::fs::read(folder.path().join(out).join(name)).expect("an image");
        assert!(read("all") == read("plain"), "{name}");
    }
}

#[test]
fn export_replaces_an_existing_file_only_with_force() {
    let folder = folder();
    for name in ["stage.npz", "stage.glb", "stage.usda"] {
        assert_eq!(run_ok(folder.path(), &["export", name, "--drawn", "--size", "128"]).trim_end(), name);
        let size = std::fs::metadata(folder.path().join(name)).expect("a file").len();
        assert!((1 << 20..40 << 20).contains(&size), "{name}: {size} bytes");
        let again = run(folder.path(), &["export", name]);
        assert_eq!(again.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&again.stderr).contains("add --force"));
    }
    let words = ["export", "stage.npz", "--force", "--json", "--preset", "surface_train_dr"];
    let summary: serde_json::Value = serde_json::from_str(&run_ok(folder.path(), &words)).expect("JSON");
    assert_eq!([&summary["file"], &summary["stage"]], ["stage.npz", "surface"]);
    assert_eq!(summary["bytes"], std::fs::metadata(folder.path().join("stage.npz")).expect("a file").len());
    let wrong = run(folder.path(), &["export", "stage.obj"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&wrong.stderr).contains(".npz, .glb, .usda"));
}

#[test]
fn the_bench_reports_every_case_and_a_sweep_plots_its_curve() {
    let folder = folder();
    let small =
        ["bench", "--frames", "3", "--size", "64", "--samples", "1", "-q", "--set", "terrain.cells=40"];
    let cases = ["camera", "static-sun", "poses", "scene", "frames", "dataset"];
    let result = run_ok(folder.path(), &[&small[..], &["--json", "--cases", &cases.join(",")]].concat());
    let result: serde_json::Value = serde_json::from_str(&result).expect("JSON");
    assert_eq!((&result["size"], &result["samples"]), (&serde_json::json!([64, 64]), &1.into()));
    assert_eq!(result["stage"], "nominal");
    let preset_words =
        ["bench", "--frames=1", "--cases=scene", "--size=32", "-q", "--json", "--preset=surface_train_dr"];
    let of_preset: serde_json::Value =
        serde_json::from_str(&run_ok(folder.path(), &preset_words)).expect("JSON");
    assert_eq!(of_preset["stage"], "surface", "a preset's stage");
    assert!(result["peak_rss_bytes"].as_u64() > Some(1 << 20) && result["adapter"]["name"].is_string());
    for case in cases {
        let case = &result["cases"][case];
        assert_eq!(case["frames"], 3);
        for key in ["median_ms", "p95_ms", "frames_per_second", "triangles", "upload_bytes", "readback_bytes"]
        {
            assert!(case[key].as_f64() > Some(0.0), "{key}: {case}");
        }
        assert!(case["stage_ms"]["gpu"].as_f64() > Some(0.0), "{case}");
        let (host_ms, is_linux) = (case["host_ms"].as_f64(), cfg!(target_os = "linux"));
        assert!(if is_linux { host_ms > Some(0.0) } else { host_ms.is_none() }, "{case}");
        assert_eq!(
            (case["process_ms"].is_number(), case["peak_rss_bytes"].is_number()),
            (is_linux, is_linux)
        );
        assert_eq!(case["redraws"], 0, "{case}");
        let parts = ["device", "workers", "writer"].map(|part| case["host_thread_ms"][part].as_f64());
        let sum: f64 = parts.into_iter().flatten().sum();
        assert!((sum - host_ms.unwrap_or_default()).abs() < 1e-6, "{case}");
        let modelled = case["host_frames_per_second_16_cores"].as_f64();
        assert!(modelled.unwrap_or_default() <= 16e3 / sum.max(1e-9) + 1e-6, "{case}");
    }
    let sweep =
        run_ok(folder.path(), &[&small[..], &["--sweep", "samples", "--plot", "samples.svg"]].concat());
    assert_eq!(sweep.lines().count(), 4, "{sweep}");
    let plot = std::fs::read_to_string(folder.path().join("samples.svg")).expect("a plot");
    assert!(plot.starts_with("<svg") && plot.matches("<circle").count() == 3);
    std::fs::write(folder.path().join("mine.txt"), "precious").expect("written");
    let output = run(folder.path(), &["bench", "--sweep", "samples", "--plot", "mine.txt"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("exists and is no plot"), "{message}");
    assert_eq!(std::fs::read_to_string(folder.path().join("mine.txt")).expect("kept"), "precious");
    assert_refused(&["bench", "--cases", "camra"], 2, &["unknown case `camra`", "static-sun"]);
}

/// Only the case `dataset` writes, into the system's folder for temporary files.
#[test]
fn the_bench_prints_what_it_measured_before_a_case_failed() {
    let folder = folder();
    let words = ["bench", "--frames=1", "--size=32", "--samples=1", "-q", "--json", "--set=terrain.cells=40"];
    let output = program(folder.path())
        .args(words)
        .arg("--cases=camera,dataset,scene")
        .env("TMPDIR", folder.path().join("missing"))
        .output()
        .expect("the program starts");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && message.contains("missing"), "{message}");
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let cases: Vec<&String> = result["cases"].as_object().expect("cases").keys().collect();
    assert_eq!(cases, ["camera"]);
}

#[test]
fn an_empty_adapter_is_refused() {
    for command in [&[][..], &["doctor"], &["bench"]] {
        assert_refused(
            &[command, &["--adapter", " "]].concat(),
            2,
            &["--adapter", "regolith-render adapters"],
        );
    }
}

#[test]
fn presets_are_listed_and_printed() {
    let folder = folder();
    let list = run_ok(folder.path(), &["presets"]);
    for (name, text) in regolith::params::presets::presets() {
        let line = list.lines().find(|line| line.trim_start().starts_with(&format!("{name} ")));
        assert!(line.is_some_and(|line| line.len() > 45), "{name}: {list}");
        assert_eq!(run_ok(folder.path(), &["presets", name]), text);
    }
    let rows: serde_json::Value =
        serde_json::from_str(&run_ok(folder.path(), &["presets", "--json"])).expect("JSON");
    assert_eq!(rows.as_array().map(Vec::len), Some(regolith::params::presets::presets().len()));
    let one: serde_json::Value =
        serde_json::from_str(&run_ok(folder.path(), &["presets", "surface_rover", "--json"])).expect("JSON");
    assert!(one["knobs"]["variant"].as_array().is_some_and(|variants| variants.len() == 4), "{one}");
    let output = run(folder.path(), &["presets", "surface_rovr"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("surface_rover"), "{message}");
}

#[test]
fn params_lists_groups_sections_and_single_knobs() {
    let folder = folder();
    let all = run_ok(folder.path(), &["params"]);
    let titles: Vec<usize> = ["# Light: ", "# Ground: ", "# Rocks: ", "# Camera: ", "# Labels: "]
        .iter()
        .map(|title| all.find(title).unwrap_or_else(|| panic!("{title} is missing")))
        .collect();
    assert!(titles.is_sorted(), "groups are in order: {titles:?}");
    let one = run_ok(folder.path(), &["params", "sun.elevation_deg", "--preset", "train_dr"]);
    assert!(one.contains("elevation_deg = { uniform = [5, 40] }") && !one.contains("intensity"), "{one}");
    let section = run_ok(folder.path(), &["params", "label"]);
    assert!(section.contains("unseen = \"rock\"") && !section.contains("[sun]"), "{section}");
    let rows: serde_json::Value =
        serde_json::from_str(&run_ok(folder.path(), &["params", "sun", "--json"])).expect("JSON");
    assert!(rows.as_array().is_some_and(|rows| rows.len() > 4 && rows[0]["group"] == "Light"), "{rows}");
    for (name, said) in [
        ("sun.elevatoin_deg", "did you mean `sun.elevation_deg`"),
        ("relief", "add --stage surface"),
        ("lable", "did you mean `label`"),
    ] {
        let output = run(folder.path(), &["params", name]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains(said), "{name}: {message}");
    }
}

#[test]
fn params_shows_single_rules_and_other_stages() {
    let folder = folder();
    let preset = ["--preset", "surface_train_full"];
    let rule = run_ok(folder.path(), &[&["params", "rules.sky_max"], &preset[..]].concat());
    assert!(rule.starts_with("[rules]\n# Largest value") && rule.ends_with("\nsky_max = 50\n"), "{rule}");
    let rule = run_ok(folder.path(), &[&["params", "rules.sky_max", "--json"], &preset[..]].concat());
    assert_eq!(rule, "50.0\n");
    let preset: serde_json::Value =
        serde_json::from_str(&run_ok(folder.path(), &["presets", "train_full", "--json"])).expect("JSON");
    assert!(preset["rules"]["require"]["rock"].is_array(), "{preset}");
    for (words, said) in [
        (&["params", "rules.skymax"][..], "did you mean `rules.sky_max`"),
        (
            &["params", "rocks.count", "--preset", "navcam"],
            "choose another preset or file, or none and --stage nominal",
        ),
        (&["params", "--set", "rules=3"], "`regolith-render params rules` lists"),
        (&["params", "--set", "preset=train_dr"], "it is the option --preset"),
        (&["params", "--set", "fallback.sensor.bits=10"], "set `sensor.bits` itself"),
        (
            &["params", "--set", "sun.intensity=99999999999999999999"],
            "sun.intensity = 1e20 in --set is out of range",
        ),
        (&["bench", "--sweep", "rocks", "--stage", "surface"], "only the stage nominal"),
        (&["--samples", "0"], "allowed are 1, 4 (2 x 2) and 16 (4 x 4)"),
    ] {
        assert_refused(words, 2, &[said]);
    }
    let listed = run_ok(folder.path(), &["params", "sun.elevation_deg", "--set", "sun.elevation_deg=05.5"]);
    assert!(listed.ends_with("elevation_deg = 5.5\n"), "{listed}");
}

/// Sources the script in a shell and asks it as the shell does.
#[test]
fn bash_completes_options_and_values_of_subcommands() {
    let folder = folder();
    let script = folder.path().join("completions.bash");
    std::fs::write(&script, run_ok(folder.path(), &["completions", "bash"])).expect("a file");
    for (words, completed) in [
        (&["--preset", "surface_ro"][..], "surface_rover"),
        (&["dataset", "--preset", "surface_ro"], "surface_rover"),
        (&["dataset", "--cou"], "--count"),
        (&["presets", "surface_ro"], "surface_rover"),
    ] {
        let line: Vec<&str> = [&["regolith-render"], words].concat();
        let ask = format!(
            "source {}; COMP_WORDS=({}); COMP_CWORD={}; _regolith__render regolith-render {} {}; echo \"${{COMPREPLY[*]}}\"",
            script.display(),
            line.join(" "),
            line.len() - 1,
            line[line.len() - 1],
            line[line.len() - 2],
        );
        let output = std::process::Command::new("bash").args(["-c", &ask]).output().expect("bash starts");
        let replies = String::from_utf8_lossy(&output.stdout);
        assert!(
            replies.split_whitespace().any(|word| word == completed),
            "{line:?}: {replies} {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

#[test]
fn shells_complete_values() {
    let folder = folder();
    for shell in ["bash", "zsh", "fish"] {
        let script = run_ok(folder.path(), &["completions", shell]);
        for value in ["surface_rover", "webdataset", "five_classes", "llvmpipe"] {
            assert!(script.contains(value), "{shell}: {value}");
        }
    }
}

/// The record of a frame is a configuration that repeats it: every plane, byte for byte.
#[test]
fn a_record_repeats_its_frame() {
    let folder = folder();
    for (preset, more) in [
        (
            "surface_rover",
            &["--size=72x56", "--samples=16", "--edges=ignore:1", "--seed=9007199254740993"][..],
        ),
        ("train_full", &["--size=64", "--set=sun.relative_azimuth_deg=77.7", "--label-ids=replicator"]),
    ] {
        let first =
            ["--preset", preset, "--outputs=rgb,mask,instances,depth,meta", "-q", "--force", "--out=first"];
        run_ok(folder.path(), &[&first, more].concat());
        let again = [
            "--config=first/frame_0000.json",
            "--outputs=rgb,mask,instances,depth,meta",
            "-q",
            "--force",
            "--out=again",
        ];
        run_ok(folder.path(), &again);
        for name in [
            "rgb_0000.png",
            "semantic_segmentation_0000.png",
            "instance_segmentation_0000.png",
            "instance_segmentation_mapping_0000.json",
            "distance_to_image_plane_0000.npy",
        ] {
            let read = |out: &str| std::fs::read(folder.path().join(out).join(name)).expect(name);
            assert!(read("first") == read("again"), "{preset}: {name} differs");
        }
        let [first, again] =
            ["first", "again"].map(|out| json(&folder.path().join(out).join("frame_0000.json")));
        for key in [
            "seed",
            "size",
            "samples",
            "edges",
            "label_ids",
            "knobs",
            "geometry_hash",
            "camera",
            "sun",
            "coverage",
        ] {
            assert_eq!(first[key], again[key], "{preset}: {key}");
        }
    }
    let changed = [
        "--config=first/frame_0000.json",
        "--set=sun.elevation_deg=70",
        "--outputs=rgb",
        "-q",
        "--out=other",
    ];
    run_ok(folder.path(), &changed);
    let read = |out: &str| std::fs::read(folder.path().join(out).join("rgb_0000.png")).expect("an image");
    assert!(read("first") != read("other"), "--set wins over the record");
    for (record, says) in [
        ("{}", "not the record of a frame"),
        (r#"{"knobs": {}, "seed": -1}"#, "`seed` is -1"),
        (r#"{"knobs": {}, "size": [32]}"#, "`size` is [32]"),
        (r#"{"knobs": {}, "samples": "4"}"#, "`samples` is \"4\""),
        (
            r#"{"knobs": {}, "label_ids": "mine"}"#,
            "`label_ids` is \"mine\"; it has to be canonical or replicator",
        ),
    ] {
        std::fs::write(folder.path().join("wrong.json"), record).expect("written");
        let output = run(folder.path(), &["--config=wrong.json"]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains(says), "{message}");
    }
}

/// A pipe has no extension that would tell a record from TOML, and can be read only once.
#[test]
fn a_record_can_come_from_standard_input_and_have_any_name() {
    let folder = folder();
    let path = folder.path();
    run_ok(path, &["--seed=7", "--size=40x24", "--samples=1", "--outputs=rgb,meta", "-q", "--out=first"]);
    let first = std::fs::read(path.join("first/rgb_0000.png")).expect("an image");
    let record = path.join("first/frame_0000.json");
    std::fs::copy(&record, path.join("record")).expect("copied");
    for config in ["record", "-", "/dev/stdin"] {
        let words = ["--config", config, "--outputs=rgb", "-q", "--force", "--out=again"];
        let mut again = program(path);
        let piped = Command::new("cat").arg(&record).stdout(Stdio::piped()).spawn();
        let mut cat = piped.expect("started");
        let output = again.args(words).stdin(cat.stdout.take().expect("a pipe")).output().expect("run");
        cat.wait().expect("ended");
        assert!(output.status.success(), "{config}: {}", String::from_utf8_lossy(&output.stderr));
        let again = std::fs::read(path.join("again/rgb_0000.png")).expect("an image");
        assert!(again == first, "--config {config} repeats the frame");
        std::fs::remove_dir_all(path.join("again")).expect("removed");
    }
}

/// What takes a configuration takes a record, with its image as far as the command has one.
#[test]
fn every_command_takes_a_record() {
    let folder = folder();
    run_ok(
        folder.path(),
        &[
            "--seed=7",
            "--size=40x24",
            "--edges=ignore:1",
            "--label-ids=replicator",
            "--outputs=rgb,meta",
            "-q",
            "--out=first",
        ],
    );
    let record = "--config=first/frame_0000.json";
    let first = json(&folder.path().join("first/frame_0000.json"));
    let parsed = |words: &[&str]| -> serde_json::Value {
        serde_json::from_str(&run_ok(folder.path(), words)).expect("JSON")
    };
    let exported = parsed(&["export", "scene.npz", record, "--json"]);
    assert_eq!(
        (&exported["seed"], &exported["geometry_hash"]),
        (&first["seed"], &first["geometry_hash"]),
        "the scene of the record"
    );
    let measured = parsed(&["bench", "--frames=1", "--cases=dataset", record, "--json", "-q"]);
    assert_eq!(measured["size"], first["size"]);
    assert_eq!(measured["cases"]["dataset"]["frames_in_flight"], 2, "of the nominal stage");
    run_ok(folder.path(), &["dataset", "--count=1", record, "-q", "--out=frames"]);
    let manifest = json(&folder.path().join("frames/manifest.json"));
    assert_eq!((&manifest["edges"], &manifest["label_ids"]), (&first["edges"], &first["label_ids"]));
    assert_eq!(first["label_ids"], "replicator");
    run_ok(folder.path(), &["dataset", "--count=1", record, "--format=coco", "-q", "--out=coco"]);
    let manifest = json(&folder.path().join("coco/manifest.json"));
    assert_eq!(manifest["label_ids"], "canonical", "a format with ids of its own");
}

/// The folder of --out is no argument: frames would go to `out` without a word.
#[test]
fn a_dataset_takes_no_folder_without_its_option() {
    for words in [
        &["dataset", "mine", "--count=1"][..],
        &["dataset", "mine", "--split=a=1"],
        &["dataset", "--merge", "mine"],
    ] {
        assert_refused(words, 2, &["mine", "--out mine"]);
    }
}
