//! The command `regolith-render`.

use std::process::{Command, ExitCode};

fn main() -> ExitCode {
    set_environment();
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    limit_arenas();
    let itself = std::env::current_exe().unwrap_or_else(|_| "regolith-render".into());
    ExitCode::from(regolith::cli::main(std::env::args_os(), &|| Command::new(&itself)))
}

/// Hides the displays of the environment from drivers, which would look for one to choose a GPU by: Mesa's Vulkan layer
/// connects to the Wayland socket `wayland-0` of the runtime folder and to the X server, and waits for their answer without a
/// limit. Frames need no display, and a socket may belong to another user or to a server that is stuck.
///
/// Also leaves out backtraces: the standard library prints one where memory runs out.
#[expect(unsafe_code, reason = "there is no other way to change the environment; see SAFETY")]
fn set_environment() {
    // SAFETY: called first in `main`, while no other thread exists that could read the environment.
    unsafe {
        std::env::remove_var("DISPLAY");
        std::env::remove_var("WAYLAND_SOCKET");
        // Unset, it would mean `wayland-0`. To an absolute path no runtime folder is added, so that none needs to exist; what
        // is no socket refuses the connection.
        std::env::set_var("WAYLAND_DISPLAY", "/dev/null");
        std::env::set_var("RUST_BACKTRACE", "0");
    }
}

/// Limits the arenas of the C library's allocator to one for every two cores. Without this each thread has one of its own, up to eight a
/// core, and an arena keeps what its threads free: on two cores those of workers and driver held 50 to 100 MB more.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[expect(unsafe_code, reason = "the standard library has no setting for it; see SAFETY")]
fn limit_arenas() {
    use std::ffi::c_int;
    /// `M_ARENA_MAX` of the header malloc.h.
    const MAX_ARENAS: c_int = -8;
    // SAFETY: the declaration is that of malloc.h; mallopt takes any two numbers, and is called while no other thread exists.
    unsafe extern "C" {
        safe fn mallopt(parameter: c_int, value: c_int) -> c_int;
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    mallopt(MAX_ARENAS, cores.div_ceil(2).min(64) as c_int);
}
