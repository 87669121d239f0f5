//! `--raster`: which backend rasterises, and where that is recorded.

use crate::support::{folder, json, program, renderer, run, run_ok};

/// What `--raster auto` is on the adapter of the tests.
fn automatic() -> &'static str {
    let renderer = renderer();
    let (info, capabilities) = (&renderer.gpu().info, renderer.gpu().capabilities);
    match info.backend {
        _ if capabilities.software_adapter => "host",
        wgpu::Backend::Vulkan => "compute",
        _ => "device",
    }
}

#[test]
fn frames_record_their_raster_backend_and_agree_on_labels() {
    let folder = folder();
    let mut masks = Vec::new();
    let modes = [("auto", automatic()), ("host", "host"), ("compute", "compute"), ("device", "device")];
    for (mode, used) in modes {
        run_ok(folder.path(), &["--size", "96", "--raster", mode, "--out", mode]);
        let out = folder.path().join(mode);
        assert_eq!(json(&out.join("frame_0000.json"))["raster"], used, "--raster {mode}");
        let mask = image::open(out.join("semantic_segmentation_0000.png")).expect("a mask");
        masks.push(mask.into_luma8().into_raw());
    }
    assert!(masks[1] == masks[2], "a compute pass rounds positions as the host does");
    let of_auto = modes.iter().rposition(|(_, used)| *used == modes[0].1).expect("a mode");
    assert!(masks[0] == masks[of_auto], "auto is {}", modes[0].1);
    let different = masks[1].iter().zip(&masks[3]).filter(|(host, device)| host != device).count();
    assert!(different <= 2, "{different} of 9216 labels differ");
}

#[test]
fn raster_modes_that_do_not_exist_or_are_not_supported_are_refused() {
    let folder = folder();
    for words in
        [&["--raster", "cpu"][..], &["bench", "--raster", "cpu"], &["verify", "--raster", "cpu", "x"]]
    {
        let output = run(folder.path(), words);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("`cpu`") || message.contains("'cpu'"), "{message}");
        assert!(message.contains("auto, device, compute and host"), "{message}");
    }
    // GL cannot copy to stencil textures, and has too few storage buffers.
    for raster in ["host", "compute"] {
        let output = program(folder.path())
            .args(["--raster", raster, "--size", "32"])
            .env_remove("WGPU_ADAPTER_NAME")
            .env("WGPU_BACKEND", "gl")
            .output()
            .expect("the program starts");
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(
            message.contains(&format!("--raster {raster}")) && message.contains("--raster auto"),
            "{message}"
        );
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "nothing is written");
}

#[test]
fn a_dataset_records_the_backend_of_each_frame_and_can_be_continued_by_another() {
    let folder = folder();
    let dataset = |count: &str, raster: &str| {
        let words = ["dataset", "--size", "48", "--out", "d", "-q", "--count", count, "--raster", raster];
        run_ok(folder.path(), &words);
    };
    dataset("1", "device");
    dataset("2", "host");
    dataset("3", "compute");
    let lines = std::fs::read_to_string(folder.path().join("d/frames.jsonl")).expect("lines");
    let used: Vec<String> = lines
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON")["raster"].to_string())
        .collect();
    assert_eq!(used, ["\"device\"", "\"host\"", "\"compute\""]);
    // The manifest's command names it, as other backends give other bytes; the default is not written out.
    let command = || json(&folder.path().join("d/manifest.json"))["command"].to_string();
    assert!(command().contains("dataset --raster compute --seed"), "{}", command());
    dataset("4", "auto");
    assert!(!command().contains("--raster"), "{}", command());
    for raster in ["auto", "device", "compute"] {
        run_ok(folder.path(), &["verify", "d", "--raster", raster]);
    }
}

#[test]
fn bench_records_the_raster_backend() {
    let folder = folder();
    for (mode, used) in [("auto", automatic()), ("device", "device"), ("compute", "compute")] {
        let words = ["bench", "--json", "-q", "--cases=scene", "--frames=1", "--size=32", "--raster", mode];
        let result: serde_json::Value = serde_json::from_str(&run_ok(folder.path(), &words)).expect("JSON");
        assert_eq!(result["raster"], used);
    }
}
