//! The command `regolith-render`: parse, run, exit status.

mod cli;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

use cli::progress::note;

fn main() -> ExitCode {
    quieten_drivers();
    // A lost device shows up as a panic inside wgpu, which is caught and reported as what it is. Whatever else
    // panics is a defect of this program, and is said to be one.
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
                "error: this is a defect of regolith-render, please report it with the command you ran: {text}"
            ));
            ExitCode::FAILURE
        }
    }
}

/// Mesa's Vulkan layers and EGL look for a Wayland display and complain on stderr where `XDG_RUNTIME_DIR` is not set,
/// as in containers and on servers. There is no display to find: any folder will do.
#[expect(unsafe_code, reason = "the environment can only be changed so; see SAFETY")]
fn quieten_drivers() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: the first thing that the program does, so no other thread reads the environment meanwhile.
        unsafe { std::env::set_var("XDG_RUNTIME_DIR", std::env::temp_dir()) };
    }
}
