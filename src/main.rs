//! The command `regolith-render`: runs the command line and turns its result into an exit status.

mod cli;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

use cli::messages::note;

fn main() -> ExitCode {
    silence_drivers();
    // A lost device is a panic inside wgpu; the library catches it and returns an error. Any other panic is a bug of
    // regolith-render and is reported as one, without a backtrace.
    std::panic::set_hook(Box::new(|_| {}));
    match catch_unwind(AssertUnwindSafe(cli::run)) {
        Ok(Ok(())) => ExitCode::SUCCESS,
        Ok(Err(error)) => {
            note(format_args!("error: {error}"));
            ExitCode::from(error.exit_status())
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

/// Sets `XDG_RUNTIME_DIR` if it is missing, as in containers and on servers: without it Mesa's Vulkan layers and EGL, which
/// look for a Wayland display, print warnings to stderr. Any folder will do, as no display is used.
#[expect(unsafe_code, reason = "`set_var` is the only way to change the environment; see SAFETY")]
fn silence_drivers() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: called first in `main`, while no other thread exists that could read the environment.
        unsafe { std::env::set_var("XDG_RUNTIME_DIR", std::env::temp_dir()) };
    }
}
