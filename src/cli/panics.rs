//! What a panic on any thread says, for the report of a bug.
//!
//! A panic on a worker ends its scope with another one, which says nothing of the first.
//! Must not know: commands.

use std::any::Any;
use std::panic::PanicHookInfo;
use std::sync::{Mutex, PoisonError};

/// What a scope says whose thread panicked.
const OF_SCOPE: &str = "a scoped thread panicked";

/// The last panic that was not a scope's.
static LAST: Mutex<Option<String>> = Mutex::new(None);

/// A hook that prints nothing and keeps what a panic says, and where.
pub(super) fn remember(panic: &PanicHookInfo<'_>) {
    let text = text_of(panic.payload());
    if text == OF_SCOPE {
        return;
    }
    let place = panic.location().map(|place| format!(" ({}:{})", place.file(), place.line()));
    *LAST.lock().unwrap_or_else(PoisonError::into_inner) =
        Some(format!("{text}{}", place.unwrap_or_default()));
}

/// What was said by the panic that ended the program with this payload.
pub(super) fn message(payload: &(dyn Any + Send)) -> String {
    let last = LAST.lock().unwrap_or_else(PoisonError::into_inner).take();
    last.unwrap_or_else(|| text_of(payload).to_owned())
}

fn text_of(payload: &(dyn Any + Send)) -> &str {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message")
}

#[cfg(test)]
mod tests {
    use std::panic::{catch_unwind, set_hook, take_hook};
    use std::thread;

    use super::*;

    #[test]
    fn the_panic_of_a_worker_is_told_not_that_of_its_scope() {
        let before = take_hook();
        set_hook(Box::new(move |panic| {
            // Not those of other tests.
            let is_here = panic.location().is_some_and(|place| place.file().ends_with("panics.rs"));
            if is_here || text_of(panic.payload()) == OF_SCOPE {
                remember(panic);
            }
            before(panic);
        }));
        let of_scope = catch_unwind(|| {
            thread::scope(|scope| {
                scope.spawn(|| assert!(libm::sin(0.0) > 0.5, "rocks have no shape"));
            });
        });
        let message = message(&*of_scope.expect_err("a panic"));
        assert!(message.contains("rocks have no shape") && message.contains("panics.rs:"), "{message}");
    }
}
