//! The command `regolith-render`: runs the command line and turns its result into an exit status.

mod cli;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

use cli::messages::note;
use cli::process::stopped_status;

fn main() -> ExitCode {
    hide_displays();
    // A lost device is a panic inside wgpu; the library catches it and returns an error. Any other panic is a bug of
    // regolith-render and is reported as one, without a backtrace.
    std::panic::set_hook(Box::new(|_| {}));
    match catch_unwind(AssertUnwindSafe(cli::run)) {
        Ok(Ok(())) => ExitCode::SUCCESS,
        Ok(Err(error)) => {
            note(format_args!("error: {error}"));
            let stopped = matches!(error, regolith::Error::Stopped { .. }).then(stopped_status).flatten();
            ExitCode::from(stopped.unwrap_or_else(|| error.exit_status()))
        }
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
            note(format_args!(
                "error: this is a bug in regolith-render; please report it together with the command you ran: {text}"
            ));
            ExitCode::FAILURE
        }
    }
}

/// Hides the displays of the environment from drivers, which would look for one to choose a GPU by: Mesa's Vulkan layer
/// connects to the Wayland socket `wayland-0` of the runtime folder and to the X server, and waits for their answer without a
/// limit. Frames need no display, and a socket may belong to another user or to a server that is stuck.
#[expect(unsafe_code, reason = "there is no other way to change the environment; see SAFETY")]
fn hide_displays() {
    // SAFETY: called first in `main`, while no other thread exists that could read the environment.
    unsafe {
        std::env::remove_var("DISPLAY");
        std::env::remove_var("WAYLAND_SOCKET");
        // Unset, it would mean `wayland-0`. To an absolute path no runtime folder is added, so that none needs to exist; what
        // is no socket refuses the connection.
        std::env::set_var("WAYLAND_DISPLAY", "/dev/null");
    }
}
