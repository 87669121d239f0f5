//! The end of the program. What a thread of the graphics driver does while the driver's own end runs is undefined: it may crash the
//! program. So before the interpreter ends, other work is waited for and none starts any more, and streams are stopped.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, RwLockReadGuard, TryLockError, Weak};
use std::thread::{self, ThreadId};
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::types::{PyCFunction, PyDict, PyTuple};
use regolith::dataset::FrameStream;

/// How long whoever is refused waits before it asks again: in vain, but the end of the interpreter stops its thread.
const ASK_EVERY: Duration = Duration::from_millis(50);

/// A stream, until it is closed.
pub(crate) type Stream = Mutex<Option<FrameStream>>;

/// Read by whoever works with a device. Written once, at the end.
static WORK: RwLock<()> = RwLock::new(());
/// The thread that ends the interpreter.
static ENDED_BY: OnceLock<ThreadId> = OnceLock::new();
/// Locked by threads with Python's lock alone, which none but the one that forks has then: no child finds it locked.
static STREAMS: Mutex<Vec<Weak<Stream>>> = Mutex::new(Vec::new());

/// Has the interpreter call [`end`] before it ends.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let process = std::process::id();
    let call = move |arguments: &Bound<'_, PyTuple>, _: Option<&Bound<'_, PyDict>>| {
        // The work of the process that this one was forked from is not its own to wait for.
        if std::process::id() == process {
            end(arguments.py());
        }
    };
    let call = PyCFunction::new_closure(module.py(), None, None, call)?;
    module.py().import("atexit")?.call_method1("register", (call,)).map(drop)
}

/// Waits for other work, of which none starts afterwards, and stops the streams.
fn end(py: Python<'_>) {
    let _ = ENDED_BY.set(thread::current().id());
    py.detach(|| std::mem::forget(WORK.write()));
    let streams: Vec<Weak<Stream>> = std::mem::take(&mut *streams(py));
    py.detach(|| streams.iter().filter_map(Weak::upgrade).for_each(|stream| close(&stream)));
}

/// What to hold during work with a device. `None` in the thread that ends the interpreter, once the others have stopped: what functions that
/// are called at exit render is done before the driver's end.
pub(crate) fn working(py: Python<'_>) -> Option<RwLockReadGuard<'static, ()>> {
    loop {
        match WORK.try_read() {
            Ok(working) => return Some(working),
            Err(TryLockError::Poisoned(error)) => return Some(error.into_inner()),
            Err(TryLockError::WouldBlock) if ENDED_BY.get() == Some(&thread::current().id()) => return None,
            Err(TryLockError::WouldBlock) => py.detach(|| thread::sleep(ASK_EVERY)),
        }
    }
}

/// A stream that [`end`] stops. To be called during work.
pub(crate) fn shared(py: Python<'_>, stream: FrameStream) -> Arc<Stream> {
    let stream = Arc::new(Mutex::new(Some(stream)));
    let mut streams = streams(py);
    streams.retain(|stream| stream.strong_count() > 0);
    streams.push(Arc::downgrade(&stream));
    stream
}

/// What is left of a stream. To be called without Python's lock: another thread may wait for a frame.
pub(crate) fn open(stream: &Stream) -> MutexGuard<'_, Option<FrameStream>> {
    stream.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stops a stream, which may take the rest of a frame. To be called as [`open`] is.
pub(crate) fn close(stream: &Stream) {
    drop(open(stream).take());
}

fn streams(_: Python<'_>) -> MutexGuard<'static, Vec<Weak<Stream>>> {
    STREAMS.lock().unwrap_or_else(PoisonError::into_inner)
}
