//! `doctor`: its reference, its verdicts, and what it says about machines made of files.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::process::Output;

use image::{ExtendedColorType, ImageBuffer, Luma};
use regolith::doctor::cases::{CASES, Case};
use regolith::doctor::findings::{Answers, Finding, findings};
use regolith::doctor::hardware::{Hardware, Machine};
use regolith::doctor::planes::Planes;
use regolith::doctor::reference::{CaseHashes, encode_depth, reference};
use regolith::render::RasterMode;

use regolith::gpu::survey::AdapterReport;
use serde_json::Value;

use crate::support::compare::updating;
use crate::support::{folder, json, missing_gl, program, render_by, renderer, run, run_ok};

/// The planes of a case on the adapter of the tests, and its hashes.
fn rendered(case: &Case) -> (Planes, CaseHashes) {
    let scene = case.scene().unwrap_or_else(|error| panic!("{error}"));
    let settings = case.settings().unwrap_or_else(|error| panic!("{error}"));
    let (frame, _) = renderer().render(&scene, &settings).unwrap_or_else(|error| panic!("{error}"));
    let planes = Planes::from(frame);
    let computed = Planes::from(render_by(RasterMode::Compute, &scene, &settings));
    let hashes = CaseHashes {
        geometry: scene.geometry_hash(),
        planes: planes.hashes(),
        computed_depth: computed.hashes().depth,
    };
    (planes, hashes)
}

fn update(rendered: &BTreeMap<&str, (Planes, CaseHashes)>) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/doctor");
    for (name, (planes, _)) in rendered {
        let [width, height] = planes.size;
        let path = |plane: &str| folder.join(format!("{name}_{plane}.png"));
        let save = |plane: &str, bytes: &[u8], kind| {
            image::save_buffer(path(plane), bytes, width, height, kind).expect("written");
        };
        let save_u16 = |plane: &str, values: Vec<u16>| {
            let image: ImageBuffer<Luma<u16>, _> =
                ImageBuffer::from_raw(width, height, values).expect("an image");
            image.save(path(plane)).expect("written");
        };
        save("rgb", &planes.rgb, ExtendedColorType::Rgb8);
        save("mask", &planes.mask, ExtendedColorType::L8);
        save_u16("instances", planes.instances.clone());
        save_u16("depth", planes.depth_m.iter().copied().map(encode_depth).collect());
    }
    let hashes: BTreeMap<&str, &CaseHashes> =
        rendered.iter().map(|(name, (_, hashes))| (*name, hashes)).collect();
    let text = serde_json::to_string_pretty(&hashes).expect("JSON") + "\n";
    std::fs::write(folder.join("hashes.json"), text).expect("written");
}

/// What is shipped is what the host rasteriser renders: where it is not, scenes or shading have changed, which is a change for users.
#[test]
fn the_shipped_reference_is_up_to_date() {
    let frames: BTreeMap<&str, _> = CASES.iter().map(|case| (case.name, rendered(case))).collect();
    if updating() {
        update(&frames);
        return;
    }
    for (name, (planes, hashes)) in frames {
        let shipped = reference(name).expect("a reference");
        let exact = |hashes: CaseHashes| {
            (hashes.geometry, hashes.planes.mask, hashes.planes.instances, hashes.computed_depth)
        };
        assert_eq!(
            exact(hashes),
            exact(shipped.hashes),
            "{name}: REGOLITH_UPDATE_GOLDENS=1 updates assets/doctor"
        );
        let largest = planes.rgb.iter().zip(&shipped.planes.rgb).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(largest <= Some(2), "{name}: colours differ by {largest:?}");
    }
}

/// Runs `doctor` with some of its frames damaged; returns its output and its report.
fn doctor(folder: &Path, faults: &str) -> (Output, Value) {
    let output = program(folder)
        .args(["doctor", "--json"])
        .env("REGOLITH_FAULT", faults)
        .output()
        .expect("the program starts");
    let report = serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {output:?}"));
    (output, report)
}

/// Verdicts of the checks of a backend, by case and plane, without those that are right.
fn not_right(report: &Value, backend: &str) -> Vec<String> {
    let checks = report["checks"].as_array().expect("checks").iter();
    let checks = checks.filter(|check| check["backend"] == backend && check["verdict"] != "right");
    checks.map(|check| format!("{} {}", text(&check["case"]), text(&check["plane"]))).collect()
}

fn text(value: &Value) -> &str {
    value.as_str().expect("a text")
}

/// The failed steps of a run.
fn failures(report: &Value, job: &str) -> Vec<String> {
    let run = report["runs"].as_array().expect("runs").iter().find(|run| run["job"] == job).expect("a run");
    let failures = run["failures"].as_array().expect("failures").iter();
    failures.map(|failure| format!("{}: {}", text(&failure["step"]), text(&failure["message"]))).collect()
}

#[test]
fn a_machine_with_right_labels_passes() {
    let folder = folder();
    let (output, report) = doctor(folder.path(), "");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}{:#}", report["checks"]);
    assert_eq!(report, json(&folder.path().join("doctor/doctor.json")), "--json prints what is written");
    assert_eq!((&report["verdict"]["labels"], &report["verdict"]["wrong"]), (&"right".into(), &0.into()));
    for job in ["host", "device-bins", "device-one-draw", "compute-one-draw", "compute-compute", "bench"] {
        let run = report["runs"].as_array().expect("runs").iter().find(|run| run["job"] == job).expect(job);
        assert!(run["memory"]["peak_rss_bytes"].as_u64() > Some(10_000_000), "{job}: {}", run["memory"]);
        let count =
            run["frames"].as_array().expect("frames").len() + run["bench"].as_object().expect("bench").len();
        assert_eq!(count, if job == "bench" { 6 } else { 2 * CASES.len() }, "{job}");
    }
    assert!(report["adapters"][0]["limits"].as_array().is_some_and(|limits| limits.len() > 10));
    let page = std::fs::read_to_string(folder.path().join("doctor/doctor.md")).expect("a page");
    assert!(page.lines().nth(2).is_some_and(|line| line.contains("Labels are right")), "{page}");
    assert!(message.contains("steps/s") && message.contains(" left"), "no progress: {message}");
    // A folder with its own reports may be used again; a folder of somebody else may not.
    std::fs::write(folder.path().join("doctor/thesis.tex"), "").expect("written");
    let refused = run(folder.path(), &["doctor"]);
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
}

#[test]
fn wrong_labels_and_a_driver_that_crashes_are_reported_and_the_rest_goes_on() {
    let folder = folder();
    let (output, report) = doctor(folder.path(), "wrong-label:host,wrong-id:host,driver-crash:device-bins");
    assert_eq!(output.status.code(), Some(1));
    let found = not_right(&report, "host");
    let case = CASES[1].name;
    for plane in ["repeat", "mask", "instances", "mask hash", "instances hash"] {
        assert!(found.contains(&format!("{case} {plane}")), "{plane}: {found:?}");
    }
    assert_eq!(found.len(), 5, "{found:?}");
    let failed = failures(&report, "device-bins");
    assert!(failed.len() == 1 && failed[0].contains("the driver ended the process (signal: 4"), "{failed:?}");
    assert!(failed[0].starts_with(case), "{failed:?}");
    let right = serde_json::json!(["device-one-draw", "compute-one-draw", "compute-compute"]);
    assert_eq!(report["verdict"]["right_backends"], right);
    let bench = report["runs"].as_array().expect("runs").last().expect("a run");
    assert_eq!(bench["bench"].as_object().map(serde_json::Map::len), Some(6), "{bench}");
}

#[test]
fn wrong_depth_and_colour_and_a_lost_device_are_reported_and_the_rest_goes_on() {
    let folder = folder();
    let (output, report) =
        doctor(folder.path(), "wrong-depth:host,wrong-colour:host,device-lost:device-bins");
    assert_eq!(output.status.code(), Some(1));
    let case = CASES[1].name;
    let found = not_right(&report, "host");
    assert_eq!(found, ["repeat", "depth", "colour"].map(|plane| format!("{case} {plane}")));
    let failed = failures(&report, "device-bins");
    assert!(failed.len() == 1 && failed[0].contains("device was lost"), "{failed:?}");
    let run = &report["runs"].as_array().expect("runs")[2];
    assert_eq!(run["frames"].as_array().map(Vec::len), Some(2 * CASES.len() - 1), "on a fresh device");
    let page = std::fs::read_to_string(folder.path().join("doctor/doctor.md")).expect("a page");
    assert!(page.contains("NOT EVERYTHING") || page.contains("LABELS ARE NOT RIGHT"), "{page}");
}

/// Drivers that crash after the last result, that write to standard output, and that crash while frame times are measured: labels are
/// right, and the report says the rest.
#[test]
fn a_driver_that_crashes_at_the_end_or_writes_text_has_right_labels() {
    let folder = folder();
    let (output, report) =
        doctor(folder.path(), "crash-at-exit:host,noise:adapters,noise:device-bins,crash-at-start:bench");
    assert!(output.status.success(), "{}{:#}", String::from_utf8_lossy(&output.stderr), report["runs"]);
    let findings = report["findings"].as_array().expect("findings");
    let crash = findings.iter().find(|finding| text(&finding["means"]).contains("when a process ends"));
    let crash = crash.unwrap_or_else(|| panic!("{findings:?}"));
    assert!(text(&crash["seen"]).contains("signal: 4"), "{crash}");
    assert!(text(&crash["remedy"]).contains("VK_DRIVER_FILES="), "{crash}");
    assert!(failures(&report, "host").is_empty() && failures(&report, "device-bins").is_empty());
    assert_eq!(failures(&report, "bench").len(), 1);
    let page = std::fs::read_to_string(folder.path().join("doctor/doctor.md")).expect("a page");
    let headline = page.lines().nth(2).expect("a headline");
    assert!(headline.contains("Labels are right") && headline.contains("failed: bench"), "{headline}");
}

/// A driver that crashes when it is loaded does so in every step: one more confirms it.
#[test]
fn a_driver_that_crashes_whenever_it_is_loaded_is_tried_twice() {
    let folder = folder();
    let (output, report) = doctor(folder.path(), "crash-at-start:adapters,crash-at-start:host");
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(report["runs"].as_array().map(Vec::len), Some(2), "{:#}", report["runs"]);
    let finding = &report["findings"][0];
    assert!(
        text(&finding["means"]).contains("could not be listed: the driver ended the process"),
        "{finding}"
    );
    assert!(text(&finding["remedy"]).contains("one by one"), "{finding}");
}

#[test]
fn without_a_driver_there_is_a_report() {
    let folder = folder();
    let output = program(folder.path())
        .arg("doctor")
        .env_remove("WGPU_ADAPTER_NAME")
        .env("VK_DRIVER_FILES", "/nonexistent.json")
        .env("VK_ICD_FILENAMES", "/nonexistent.json")
        .env("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent.json")
        .output()
        .expect("the program starts");
    assert_eq!(output.status.code(), Some(1));
    let summary = String::from_utf8_lossy(&output.stdout);
    assert!(summary.contains("mesa-vulkan-drivers") && summary.contains("VK_DRIVER_FILES"), "{summary}");
    assert!(json(&folder.path().join("doctor/doctor.json"))["verdict"]["labels"] == "unchecked");
    let unknown = run(folder.path(), &["doctor", "--adapter", "voodoo"]);
    assert_eq!(unknown.status.code(), Some(2), "{}", String::from_utf8_lossy(&unknown.stderr));
}

/// Files of a machine: path below the root and content.
type Files = &'static [(&'static str, &'static str)];
/// Environment variables: name and value.
type Variables = &'static [(&'static str, &'static str)];

fn create(root: &Path, files: &[(&str, &str)]) {
    for (path, content) in files {
        let path = root.join(path);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        std::fs::write(path, content).expect("written");
    }
}

/// What is said about a machine of these files and variables, on which these adapters answer.
fn said(files: Files, variables: &[(&str, &str)], adapters: &[AdapterReport]) -> Vec<Finding> {
    said_of(files, variables, &Answers { adapters, ..Answers::default() })
}

/// The same, whatever the drivers answer.
fn said_of(files: &[(&str, &str)], variables: &[(&str, &str)], answers: &Answers<'_>) -> Vec<Finding> {
    let folder = folder();
    create(folder.path(), files);
    let variables = variables.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
    // Tests may run as root, who can open everything: a file that says so cannot be opened.
    let open = |path: &Path| match std::fs::read_to_string(path) {
        Ok(text) if text == "denied" => Err(io::ErrorKind::PermissionDenied.into()),
        // EPERM, by which a device cgroup withholds a device.
        Ok(text) if text == "withheld" => Err(io::Error::from_raw_os_error(1)),
        other => other.map(drop),
    };
    findings(&Hardware::probe(&Machine::new(folder.path(), variables, open)), answers)
}

fn adapter_of(vendor: u32, name: &str) -> AdapterReport {
    AdapterReport {
        name: name.to_owned(),
        kind: "discrete GPU".to_owned(),
        backend: "vulkan".to_owned(),
        driver: "a driver".to_owned(),
        vendor,
        device: 1,
        pci_address: String::new(),
        is_software: vendor == 0,
        missing: Vec::new(),
        limits: Vec::new(),
    }
}

const LOADER: (&str, &str) = ("usr/lib/libvulkan.so.1", "");
const NVIDIA_FILE: (&str, &str) = ("dev/nvidia0", "");
const NVIDIA_PCI: [(&str, &str); 3] = [
    ("sys/bus/pci/devices/0000:01:00.0/vendor", "0x10de\n"),
    ("sys/bus/pci/devices/0000:01:00.0/class", "0x030200\n"),
    ("sys/bus/pci/devices/0000:01:00.0/device", "0x2335\n"),
];
const NVIDIA_MANIFEST: (&str, &str) =
    ("etc/vulkan/icd.d/nvidia_icd.json", r#"{"ICD": {"library_path": "libGLX_nvidia.so.0"}}"#);
const NVIDIA_MODULE: (&str, &str) = ("proc/driver/nvidia/version", "NVRM version: 580.95.05");
const NVIDIA_DRI: [(&str, &str); 2] =
    [("dev/dri/renderD128", ""), ("sys/class/drm/renderD128/device/vendor", "0x10de\n")];
/// As Debian's Mesa installs it on every machine.
const NOUVEAU_MANIFEST: [(&str, &str); 2] = [
    (
        "usr/share/vulkan/icd.d/nouveau_icd.x86_64.json",
        r#"{"ICD": {"library_path": "/usr/lib/libvulkan_nouveau.so"}}"#,
    ),
    ("usr/lib/libvulkan_nouveau.so", ""),
];
const LVP_MANIFEST: (&str, &str) = ("usr/share/vulkan/icd.d/lvp_icd.json", "{}");
const AMD_FILE: (&str, &str) = ("dev/dri/renderD128", "");
const AMD_VENDOR: (&str, &str) = ("sys/class/drm/renderD128/device/vendor", "0x1002\n");

/// Each row: a machine, its variables, and what the remedy of its GPU says.
#[test]
fn the_remedy_fits_the_first_cause() {
    let machines: &[(&str, Files, Variables, &str)] = &[
        (
            "a module that is not loaded",
            &[LOADER, NVIDIA_PCI[0], NVIDIA_PCI[1], NVIDIA_PCI[2]],
            &[],
            "modprobe nvidia",
        ),
        (
            "a container without the GPU",
            &[LOADER, NVIDIA_PCI[0], NVIDIA_PCI[1], (".dockerenv", "")],
            &[],
            "docker run --gpus all -e NVIDIA_DRIVER_CAPABILITIES=graphics",
        ),
        (
            "a container without the GPU",
            &[LOADER, NVIDIA_PCI[0], NVIDIA_PCI[1], ("run/.containerenv", "")],
            &[],
            "--device nvidia.com/gpu=all",
        ),
        (
            "a container without the GPU",
            &[LOADER, NVIDIA_PCI[0], NVIDIA_PCI[1]],
            &[("APPTAINER_CONTAINER", "/image.sif")],
            "apptainer exec --nv",
        ),
        (
            "a job without a GPU",
            &[LOADER, NVIDIA_PCI[0], NVIDIA_PCI[1]],
            &[("SLURM_JOB_ID", "7")],
            "--gres=gpu:1",
        ),
        (
            "a container without the capability",
            &[LOADER, NVIDIA_FILE, (".dockerenv", "")],
            &[("NVIDIA_DRIVER_CAPABILITIES", "compute,utility")],
            "-e NVIDIA_DRIVER_CAPABILITIES=graphics,utility",
        ),
        (
            "a container with the capability, on a host without graphics libraries",
            &[LOADER, NVIDIA_FILE, (".dockerenv", "")],
            &[("NVIDIA_DRIVER_CAPABILITIES", "all")],
            "--runtime=nvidia",
        ),
        (
            "a driver for computing only",
            &[
                LOADER,
                NVIDIA_FILE,
                (
                    "proc/driver/nvidia/version",
                    "NVRM version: NVIDIA UNIX x86_64 Kernel Module  580.95.05  Tue Sep 23\nGCC version: 12",
                ),
            ],
            &[],
            "libnvidia-gl-580",
        ),
        ("no loader", &[NVIDIA_FILE, NVIDIA_MANIFEST], &[], "apt-get install libvulkan1"),
        (
            "a manifest without its library",
            &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST],
            &[],
            "graphics libraries",
        ),
        (
            "a driver that reports nothing",
            &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST, ("usr/lib/libGLX_nvidia.so.0", "")],
            &[],
            "nvidia-smi",
        ),
        (
            "a manifest in an unusual folder",
            &[LOADER, NVIDIA_FILE, ("usr/local/nvidia/vulkan/icd.d/nvidia_icd.json", "{}")],
            &[],
            "export VK_DRIVER_FILES=/usr/local/nvidia/vulkan/icd.d/nvidia_icd.json",
        ),
        (
            "manifests replaced",
            &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST, ("usr/share/vulkan/icd.d/lvp_icd.json", "{}")],
            &[("VK_DRIVER_FILES", "/usr/share/vulkan/icd.d/lvp_icd.json")],
            "unset VK_DRIVER_FILES",
        ),
        ("GL only", &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST], &[("WGPU_BACKEND", "gl")], "unset WGPU_BACKEND"),
        ("no driver", &[LOADER, AMD_FILE, AMD_VENDOR], &[], "apt-get install mesa-vulkan-drivers"),
        (
            "no permission",
            &[LOADER, ("dev/dri/renderD128", "denied"), AMD_VENDOR],
            &[],
            "usermod -aG render,video",
        ),
        (
            "a job from which the GPUs are withheld",
            &[LOADER, ("dev/nvidia0", "withheld")],
            &[("SLURM_JOB_ID", "7")],
            "--gres=gpu:1",
        ),
        (
            "a container from which the GPU is withheld",
            &[LOADER, ("dev/nvidia0", "withheld"), (".dockerenv", "")],
            &[],
            "docker run --gpus all",
        ),
        (
            "Podman, on a host without graphics libraries",
            &[LOADER, NVIDIA_FILE, ("run/.containerenv", "")],
            &[],
            "nvidia-ctk cdi generate",
        ),
        (
            "a container without the capability, with Mesa's drivers",
            &[LOADER, NVIDIA_FILE, NOUVEAU_MANIFEST[0], NOUVEAU_MANIFEST[1], (".dockerenv", "")],
            &[],
            "-e NVIDIA_DRIVER_CAPABILITIES=graphics,utility",
        ),
        (
            "a driver for computing only, with Mesa's drivers",
            &[LOADER, NVIDIA_FILE, NVIDIA_MODULE, NOUVEAU_MANIFEST[0], NOUVEAU_MANIFEST[1]],
            &[],
            "libnvidia-gl-580",
        ),
        (
            "nouveau, with Mesa's drivers",
            &[LOADER, NVIDIA_DRI[0], NVIDIA_DRI[1], NOUVEAU_MANIFEST[0], NOUVEAU_MANIFEST[1]],
            &[],
            "update Mesa",
        ),
        (
            "nouveau, without Mesa's drivers",
            &[LOADER, NVIDIA_DRI[0], NVIDIA_DRI[1]],
            &[],
            "in place of the kernel's nouveau",
        ),
        (
            "a container with /dev/dri of an NVIDIA GPU",
            &[LOADER, NVIDIA_DRI[0], NVIDIA_DRI[1], NVIDIA_MODULE, (".dockerenv", "")],
            &[],
            "docker run --gpus all -e NVIDIA_DRIVER_CAPABILITIES=graphics",
        ),
        (
            "a driver that is left out",
            &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST],
            &[("VK_LOADER_DRIVERS_DISABLE", "*lvp*, NVIDIA*")],
            "correct or unset VK_LOADER_DRIVERS_DISABLE",
        ),
        (
            "a driver that is not selected",
            &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST],
            &[("VK_LOADER_DRIVERS_SELECT", "lvp*")],
            "correct or unset VK_LOADER_DRIVERS_SELECT",
        ),
        (
            "a driver that is selected",
            &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST, ("usr/lib/libGLX_nvidia.so.0", "")],
            &[("VK_LOADER_DRIVERS_SELECT", "*nvidia_icd.json"), ("VK_LOADER_DRIVERS_DISABLE", "intel*")],
            "nvidia-smi",
        ),
        ("computing only", &[LOADER, ("dev/kfd", "")], &[], "/dev/dri as well as /dev/kfd"),
        ("WSL", &[LOADER, ("dev/dxg", "")], &[], "GALLIUM_DRIVER=d3d12"),
    ];
    for (machine, files, variables, expected) in machines {
        let said = said(files, variables, &[adapter_of(0, "llvmpipe")]);
        assert!(said[0].remedy.contains(expected), "{machine}: {said:?}");
        assert!(said.iter().all(|finding| finding.seen != "no adapter"), "{machine}: {said:?}");
    }
}

#[test]
fn a_gpu_that_answers_and_a_machine_without_one_need_no_remedy() {
    let nvidia = adapter_of(0x10de, "NVIDIA H200");
    let found = said(
        &[LOADER, NVIDIA_FILE, NVIDIA_MANIFEST],
        &[("CUDA_VISIBLE_DEVICES", "3")],
        std::slice::from_ref(&nvidia),
    );
    assert!(found.iter().all(|finding| !finding.is_problem()), "{found:?}");
    assert!(found.iter().any(|finding| finding.means.contains("NVIDIA H200")), "{found:?}");
    assert!(found.iter().any(|finding| finding.seen.contains("CUDA_VISIBLE_DEVICES=3")), "{found:?}");
    // Server management and virtual machines have display adapters that are no GPUs.
    let aspeed: Files = &[("dev/dri/renderD128", ""), ("sys/class/drm/renderD128/device/vendor", "0x1a03")];
    for files in [aspeed, &[]] {
        let found = said(files, &[], &[adapter_of(0, "llvmpipe")]);
        assert!(found.len() == 1 && found[0].seen.starts_with("no GPU"), "{found:?}");
    }
    // An adapter of another vendor does not answer for a GPU, and one that lacks something cannot be used.
    let found = said(&[LOADER, AMD_FILE, AMD_VENDOR], &[], std::slice::from_ref(&nvidia));
    assert!(found[0].is_problem(), "{found:?}");
    let lacking = AdapterReport { missing: vec!["compute shaders".to_owned()], ..nvidia };
    let found = said(&[NVIDIA_FILE], &[], &[lacking]);
    assert!(found[0].remedy.contains("update"), "{found:?}");
}

/// GPUs of one model differ in their PCI address alone.
#[test]
fn a_pci_address_selects_an_adapter() {
    let at = |address: &str| AdapterReport {
        pci_address: address.to_owned(),
        ..adapter_of(0x10de, "NVIDIA H200")
    };
    let [first, second] = [at("0000:1b:00.0"), at("0000:43:00.0")];
    assert_eq!(first.describe(), second.describe());
    assert!(first.identify().ends_with("PCI 0000:1b:00.0"), "{}", first.identify());
    assert!([&first, &second].iter().all(|adapter| adapter.matches("h200")));
    assert!(second.matches("43:00") && !first.matches("43:00"));
}

/// Each row: variables, how listing the adapters failed, and what is said where nothing answers.
#[test]
fn the_remedy_fits_where_no_driver_answers() {
    let rows: &[(Variables, Option<&str>, &[&str])] = &[
        (&[], None, &["tried: vulkan, gl", "mesa-vulkan-drivers"]),
        (&[("WGPU_BACKEND", "gl")], None, &["WGPU_BACKEND allows no other", "unset WGPU_BACKEND", "libegl1"]),
        (
            &[("VK_LOADER_DRIVERS_DISABLE", "*")],
            None,
            &["VK_LOADER_DRIVERS_DISABLE=*", "lvp_icd.json", "unset VK_LOADER_DRIVERS_DISABLE"],
        ),
        (
            &[],
            Some("signal: 11"),
            &["could not be listed: signal: 11", "VK_DRIVER_FILES", "icd.d/lvp_icd.json"],
        ),
    ];
    for (variables, failure, expected) in rows {
        let answers = Answers { failure: *failure, ..Answers::default() };
        let found = said_of(&[LOADER, LVP_MANIFEST], variables, &answers);
        let no_adapter = found.iter().find(|finding| finding.seen == "no adapter").expect("a finding");
        let said = format!("{}: {}", no_adapter.means, no_adapter.remedy);
        assert!(expected.iter().all(|text| said.contains(text)), "{variables:?}: {said}");
    }
    // A driver that may answer is not blamed, and its GPU is not denied.
    let files = [LOADER, NVIDIA_FILE, NVIDIA_MANIFEST, ("usr/lib/libGLX_nvidia.so.0", "")];
    let found = said_of(&files, &[], &Answers { failure: Some("signal: 11"), ..Answers::default() });
    assert!(found.len() == 1 && found[0].seen == "no adapter", "{found:?}");
}

#[test]
fn a_relative_path_of_a_manifest_starts_at_the_current_folder() {
    let folder = std::env::current_dir().expect("a folder");
    let manifest = folder.join("drivers/lvp_icd.json");
    let manifest = manifest.to_str().expect("text").trim_start_matches('/');
    for (path, count) in [("drivers/lvp_icd.json", 0), ("drivers/other_icd.json", 1)] {
        let variables = [("VK_DRIVER_FILES", path)];
        let adapters = [adapter_of(0, "llvmpipe")];
        let answers = Answers { adapters: &adapters, ..Answers::default() };
        let found = said_of(&[LOADER, (manifest, "{}")], &variables, &answers);
        let problems = found.iter().filter(|finding| finding.means.contains("not a driver manifest")).count();
        assert_eq!(problems, count, "{path}: {found:?}");
    }
}

/// Secrets in variables that start like those of drivers are not written down.
#[test]
fn a_report_has_no_secrets() {
    let folder = folder();
    let variables = ["NVIDIA_API_KEY", "APPTAINER_DOCKER_PASSWORD", "SLURM_JOB_USER", "HOME", "WGPU_BACKEND"];
    let variables = variables.iter().map(|name| ((*name).to_owned(), "secret".to_owned())).collect();
    let machine = Machine::new(folder.path(), variables, |_| Ok(()));
    let report = Hardware::probe(&machine).to_json();
    assert_eq!(report["environment"], serde_json::json!({ "WGPU_BACKEND": "secret" }));
}

/// Whether the best adapter of this machine is a GPU.
fn has_gpu(folder: &Path) -> bool {
    let adapters: Value = serde_json::from_str(&run_ok(folder, &["adapters", "--json"])).expect("JSON");
    adapters[0]["kind"] != "CPU driver"
}

/// On Windows' subsystem for Linux Vulkan renders on the CPU, and GL may reach the GPU. Mesa's CPU driver takes another name for it here.
#[test]
fn a_gpu_that_only_gl_reaches_is_used() {
    let folder = folder();
    if has_gpu(folder.path()) || !missing_gl().is_empty() {
        return;
    }
    let (with, without) = (folder.path().join("with"), folder.path().join("without"));
    create(&with, &[("dev/dxg", "")]);
    create(&without, &[("dev/null", "")]);
    let renderer = "D3D12 (NVIDIA GeForce RTX 3070)";
    for (root, gl_renderer, expected) in
        [(&with, Some(renderer), "gl"), (&without, Some(renderer), "vulkan"), (&with, None, "vulkan")]
    {
        let mut command = program(folder.path());
        command.env_remove("WGPU_ADAPTER_NAME").env("REGOLITH_MACHINE", root);
        if let Some(name) = gl_renderer {
            command.env("force_gl_renderer", name).env("force_gl_vendor", "Microsoft Corporation");
        }
        let output = command.args(["--size=32", "--force", "--json"]).output().expect("the program starts");
        let message = String::from_utf8_lossy(&output.stderr);
        let result: Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {message}"));
        assert_eq!(
            result["frame"]["adapter"]["backend"],
            expected,
            "{}, {gl_renderer:?}: {message}",
            root.display()
        );
    }
}

/// A command that falls back to the CPU although there is a GPU says so once, and only where nobody chose the CPU.
#[test]
fn falling_back_to_the_cpu_is_said_once() {
    let folder = folder();
    if has_gpu(folder.path()) {
        return; // Nothing falls back.
    }
    let (with, without) = (folder.path().join("with"), folder.path().join("without"));
    create(&with, &[NVIDIA_FILE]);
    create(&without, &[("dev/null", "")]);
    let frame = ["--size=32", "--force"];
    let dataset = ["dataset", "--count=1", "--size=32", "--out=data", "--force"];
    let verify = ["verify", "data"];
    let bench = ["bench", "--cases=camera", "--frames=1", "--size=32"];
    let warnings = |root: &Path, words: &[&str]| {
        let mut command = program(folder.path());
        let output =
            command.env_remove("WGPU_ADAPTER_NAME").env("REGOLITH_MACHINE", root).args(words).output();
        let output = output.expect("the program starts");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{words:?}: {message}");
        assert!(!String::from_utf8_lossy(&output.stdout).contains("warning"), "{words:?}");
        message.lines().filter(|line| line.contains("/dev/nvidia0") && line.contains("doctor")).count()
    };
    for words in [&frame[..], &dataset, &verify, &bench] {
        assert_eq!(warnings(&with, words), 1, "{words:?}");
    }
    assert_eq!(warnings(&without, &frame), 0);
    for option in ["-q", "--adapter=cpu"] {
        assert_eq!(warnings(&with, &[&frame[..], &[option]].concat()), 0, "{option}");
    }
}
