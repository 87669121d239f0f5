//! What surrounds a run: sockets of others, limits of the process. None of it may hang or crash a run.

use std::ffi::OsStr;
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::{folder, missing_gl, program};

/// Time after which a command of these tests counts as hanging.
const LIMIT: Duration = Duration::from_secs(60);

/// The command without any display, which a test may add.
fn program_without_display(folder: &Path) -> Command {
    let mut command = program(folder);
    for name in ["XDG_RUNTIME_DIR", "WAYLAND_DISPLAY", "WAYLAND_SOCKET", "DISPLAY"] {
        command.env_remove(name);
    }
    command
}

/// The output of a command, which is killed if it hangs.
fn output_within_limit(command: &mut Command) -> Output {
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("a start");
    let start = Instant::now();
    while child.try_wait().expect("a status").is_none() {
        if start.elapsed() > LIMIT {
            child.kill().expect("killed");
            panic!(
                "{command:?} hangs: {}",
                String::from_utf8_lossy(&child.wait_with_output().expect("output").stderr)
            );
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.wait_with_output().expect("output")
}

/// A socket that accepts connections and never answers, as that of another user or of a server that is stuck: drivers that
/// connect to it, as to a display, wait forever.
#[test]
fn no_run_connects_to_a_display() {
    let folder = folder();
    let socket = folder.path().join("wayland-0");
    let listener = UnixListener::bind(&socket).expect("a socket");
    listener.set_nonblocking(true).expect("a socket that does not block");
    let renders_by_gl = missing_gl().is_empty();
    for (variable, value) in [
        ("TMPDIR", folder.path()),
        ("XDG_RUNTIME_DIR", folder.path()),
        ("WAYLAND_DISPLAY", &socket),
        ("DISPLAY", &socket),
    ] {
        for backend in ["vulkan", "gl"] {
            // The first case renders a frame; the others open the driver.
            let words: &[&str] =
                if variable == "TMPDIR" { &["--size", "32", "--force"] } else { &["adapters"] };
            let mut command = program_without_display(folder.path());
            let output =
                output_within_limit(command.args(words).env("WGPU_BACKEND", backend).env(variable, value));
            let message = String::from_utf8_lossy(&output.stderr);
            assert!(
                (output.status.success() || (backend == "gl" && variable == "TMPDIR" && !renders_by_gl))
                    && message.lines().all(|line| !line.contains("XDG_RUNTIME_DIR")),
                "{message}"
            );
            let connection = listener.accept().map_err(|error| error.kind());
            assert!(
                matches!(connection, Err(ErrorKind::WouldBlock)),
                "{backend} with {variable}={} connects to a display",
                value.display()
            );
        }
    }
}

/// The command with a limit (`ulimit`).
fn limited(folder: &Path, (option, limit): (&str, u32), words: &[&str]) -> Command {
    let unlimited = program_without_display(folder);
    let mut limited = Command::new("sh");
    limited.arg("-c").arg(format!("ulimit {option} {limit}; exec \"$0\" \"$@\""));
    limited.arg(unlimited.get_program()).args(words).current_dir(folder);
    for (name, value) in unlimited.get_envs() {
        match value {
            Some(value) => limited.env(name, value),
            None => limited.env_remove(name),
        };
    }
    limited
}

/// A driver that cannot open its files is not found. It would be wrong advice to install one.
#[test]
fn too_few_open_files_are_an_error_with_its_remedy() {
    let folder = folder();
    for words in [&["--size=16", "--out=out"][..], &["adapters"], &["dataset", "--count=1", "--size=16"]] {
        for files in [4, 5, 6] {
            let output = output_within_limit(&mut limited(folder.path(), ("-n", files), words));
            let message = String::from_utf8_lossy(&output.stderr);
            let is_refused = output.status.code() == Some(1)
                && message.trim_end().lines().count() == 1
                && message.contains("raise the limit of open files (`ulimit -n`)")
                && !message.contains(".tmp");
            let may_run = words == ["adapters"] && output.status.success();
            assert!(is_refused || may_run, "{files} files, {words:?}: {:?}: {message}", output.status);
        }
    }
    assert!(!folder.path().join("out").exists());
}

/// Below a limit on the memory of a process, drivers crash: a run says so before it loads one.
#[test]
fn a_limit_of_memory_is_an_error_in_one_line() {
    let folder = folder();
    let frame = ["--size", "64", "--force"];
    let dataset =
        ["dataset", "--count=2", "--size=64", "--preset=surface_train_full", "--threads=8", "--out=data"];
    for (option, kibibytes, words) in [
        ("-v", 300_000, &frame[..]),
        ("-v", 600_000, &frame),
        ("-v", 900_000, &dataset),
        ("-v", 1_200_000, &dataset),
        ("-v", 1_200_000, &["adapters"]),
        ("-v", 2_000_000, &frame),
        ("-d", 50_000, &dataset),
        ("-d", 200_000, &dataset),
    ] {
        let output = output_within_limit(&mut limited(folder.path(), (option, kibibytes), words));
        let message = String::from_utf8_lossy(&output.stderr);
        let is_refused = output.status.code() == Some(1)
            && message.trim_end().lines().count() == 1
            && message.contains("of this process is limited to")
            && message.contains(&format!("ulimit {option} unlimited"));
        let may_run = kibibytes == 2_000_000 && output.status.success();
        assert!(
            is_refused || may_run,
            "ulimit {option} {kibibytes}, {words:?}: {:?}: {message}",
            output.status
        );
    }
}

#[test]
fn variables_that_are_not_text_are_refused() {
    let folder = folder();
    for name in ["WGPU_BACKEND", "WGPU_ADAPTER_NAME"] {
        for words in [&["--size=32"][..], &["doctor"]] {
            let mut command = program_without_display(folder.path());
            let output = output_within_limit(command.args(words).env(name, OsStr::from_bytes(b"\xffvulkan")));
            let message = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{name}, {words:?}: {message}");
            assert!(message.contains(name) && message.contains("UTF-8"), "{message}");
        }
    }
}

#[test]
fn variables_that_leave_no_adapter_are_named() {
    let folder = folder();
    for words in [&["--size=32"][..], &["doctor"]] {
        let mut command = program_without_display(folder.path());
        command.args(words).env("WGPU_BACKEND", "vulkan").env("WGPU_ADAPTER_NAME", "voodoo");
        let output = output_within_limit(&mut command);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {message}");
        let variables = "(the environment has WGPU_BACKEND=vulkan and WGPU_ADAPTER_NAME=voodoo)";
        assert!(message.contains(variables), "{words:?}: {message}");
    }
}

/// Mesa's CPU driver compiles for the instruction sets of the processor. They make frames faster and change none of their labels and
/// shadows; with or without fused operations a colour may round to the next step.
#[test]
fn pixels_do_not_depend_on_the_instruction_sets_of_the_driver() {
    let frame = |instruction_sets: Option<&str>| {
        let folder = folder();
        let mut command = program_without_display(folder.path());
        command.args([
            "--seed",
            "5",
            "--stage",
            "surface",
            "--size",
            "64",
            "--outputs",
            "all",
            "--out",
            "out",
        ]);
        if let Some(names) = instruction_sets {
            command.env("GALLIUM_OVERRIDE_CPU_CAPS", names);
        }
        let output = output_within_limit(&mut command);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let path = |name| folder.path().join("out").join(name);
        let names = ["semantic_segmentation_0000.png", "shadow_0000.png"];
        let exact = names.map(|name| std::fs::read(path(name)).expect("a file"));
        (exact, image::open(path("rgb_0000.png")).expect("an image").into_rgb8())
    };
    let (labels, colours) = frame(None);
    for instruction_sets in ["sse4.1", "avx"] {
        let (other_labels, other_colours) = frame(Some(instruction_sets));
        assert!(other_labels == labels, "{instruction_sets}");
        let steps = || colours.iter().zip(other_colours.iter()).map(|(a, b)| a.abs_diff(*b));
        let differing = steps().filter(|step| *step > 0).count();
        assert!(steps().all(|step| step <= 1) && differing < 20, "{instruction_sets}: {differing} values");
    }
}
