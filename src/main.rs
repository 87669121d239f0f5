//! The command `regolith-render`: parse, run, exit status.

mod cli;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

#[expect(clippy::print_stderr, reason = "messages to people go to stderr")]
fn main() -> ExitCode {
    // A lost device shows up as a panic inside wgpu, which is caught and reported as what it is. Whatever else
    // panics is a defect of this program, and is said to be one.
    std::panic::set_hook(Box::new(|_| {}));
    match catch_unwind(AssertUnwindSafe(cli::run)) {
        Ok(Ok(())) => ExitCode::SUCCESS,
        Ok(Err(error)) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_status())
        }
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
            eprintln!("error: this is a defect of regolith-render, please report it with the command you ran: {text}");
            ExitCode::FAILURE
        }
    }
}
