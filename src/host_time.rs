//! Processor time of the program's own threads: what the host spends on frames, without the threads that a driver starts.
//!
//! A driver's threads cannot be told from others by what the system knows of them, so the program's own threads register. What a
//! driver does in calls from them counts.
//! Must not know: what the threads do.

use std::collections::BTreeSet;
use std::fs;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The registered threads.
static THREADS: Mutex<Threads> = Mutex::new(Threads { running: BTreeSet::new(), ended_ns: 0 });

#[derive(Debug)]
struct Threads {
    /// Their numbers in `/proc/self/task`.
    running: BTreeSet<u32>,
    /// Processor time of those that have ended, nanoseconds.
    ended_ns: u64,
}

fn threads() -> MutexGuard<'static, Threads> {
    THREADS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The registration of a thread; dropped when the thread ends.
#[derive(Debug)]
pub struct Registration(Option<u32>);

/// Registers the calling thread, unless it is registered already or the system does not report times of threads.
#[must_use]
pub fn register() -> Registration {
    let link = fs::read_link("/proc/thread-self").ok();
    let id = link.and_then(|link| link.file_name()?.to_str()?.parse().ok());
    Registration(id.filter(|id| threads().running.insert(*id)))
}

impl Drop for Registration {
    fn drop(&mut self) {
        if let Some(id) = self.0 {
            let mut threads = threads();
            threads.running.remove(&id);
            threads.ended_ns += of_thread_ns(id).unwrap_or_default();
        }
    }
}

/// Processor time of all registered threads so far, with those that have ended, milliseconds; `None` where the system does not
/// report it (it does on Linux).
#[must_use]
pub fn total_ms() -> Option<f64> {
    let threads = threads();
    let running = threads.running.iter().map(|&id| of_thread_ns(id)).sum::<Option<u64>>()?;
    (!threads.running.is_empty()).then_some((threads.ended_ns + running) as f64 * 1e-6)
}

/// Time that a thread of this process has spent on a processor, nanoseconds.
fn of_thread_ns(id: u32) -> Option<u64> {
    let times = fs::read_to_string(format!("/proc/self/task/{id}/schedstat")).ok()?;
    times.split_whitespace().next()?.parse().ok()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    fn work() -> u64 {
        (0..20_000_000_u64).fold(1, |hash, i| std::hint::black_box(hash.wrapping_mul(31) ^ i))
    }

    #[test]
    fn only_registered_threads_count_and_ended_ones_stay() {
        let _registration = register();
        assert!(register().0.is_none(), "this thread is registered already");
        let before = total_ms().expect("a time");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let _registration = register();
                work();
            });
        });
        let with_one = total_ms().expect("a time");
        assert!(with_one - before > 1.0, "{before} to {with_one} ms");
        // Longer than the registered one, and not counted.
        std::thread::scope(|scope| scope.spawn(|| (0..8).map(|_| work()).sum::<u64>()).join())
            .expect("a thread");
        let with_other = total_ms().expect("a time");
        assert!(with_other - with_one < 2.0 * (with_one - before), "{before}, {with_one}, {with_other} ms");
    }
}
