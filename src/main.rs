//! The command `regolith-render`.

use std::process::{Command, ExitCode};

fn main() -> ExitCode {
    hide_displays();
    let itself = std::env::current_exe().unwrap_or_else(|_| "regolith-render".into());
    ExitCode::from(regolith::cli::main(std::env::args_os(), &|| Command::new(&itself)))
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
