//! What surrounds a run: sockets of others, limits of the process. None of it may hang or crash a run.

use std::io::ErrorKind;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::support::{folder, program};

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
                output.status.success() && message.lines().all(|line| !line.contains("XDG_RUNTIME_DIR")),
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
