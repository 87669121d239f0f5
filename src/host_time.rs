//! Processor time of the program's own threads: what the host spends on frames, without the threads that a driver starts.
//!
//! A driver's threads cannot be told from others by what the system knows of them, so the program's own threads register. What a
//! driver does in calls from them counts. Without [`start`] nothing is registered, so that no thread takes a lock that a process forked
//! from this one would find taken for ever.
//! Must not know: what the threads do.

use std::collections::BTreeMap;
use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What a thread does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The one that owns the device.
    Device,
    /// One of several that prepare and finish frames.
    Worker,
    /// The one that writes files.
    Writer,
    /// One of the pool to which parallel loops are shared out.
    Pool,
}

/// Milliseconds by role.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoleTimes([f64; 4]);

impl RoleTimes {
    /// Times of the thread of the device, the workers and the writer.
    #[must_use]
    pub const fn new(device: f64, worker: f64, writer: f64) -> Self {
        Self([device, worker, writer, 0.0])
    }

    /// Those of a role.
    #[must_use]
    pub const fn of(&self, role: Role) -> f64 {
        self.0[role as usize]
    }

    /// Those of all roles.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.0.iter().sum()
    }

    /// What was added since `before`, divided by a number of frames.
    #[must_use]
    pub fn since(&self, before: &Self, frames: usize) -> Self {
        Self(std::array::from_fn(|role| (self.0[role] - before.0[role]) / frames.max(1) as f64))
    }
}

/// Whether threads register.
static STARTED: AtomicBool = AtomicBool::new(false);
/// The registered threads.
static THREADS: Mutex<Threads> = Mutex::new(Threads { running: BTreeMap::new(), ended_ns: [0; 4] });

#[derive(Debug)]
struct Threads {
    /// By their numbers in `/proc/self/task`.
    running: BTreeMap<u32, Role>,
    /// Processor time of those that have ended, by role, nanoseconds.
    ended_ns: [u64; 4],
}

fn threads() -> MutexGuard<'static, Threads> {
    THREADS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// From now on threads register.
pub fn start() {
    STARTED.store(true, Ordering::Relaxed);
}

/// The registration of a thread; dropped when the thread ends.
#[derive(Debug)]
pub struct Registration(Option<u32>);

/// Registers the calling thread, unless nothing has [started](start), it is registered already, or the system does not report times of
/// threads.
#[must_use]
pub fn register(role: Role) -> Registration {
    if !STARTED.load(Ordering::Relaxed) {
        return Registration(None);
    }
    let link = fs::read_link("/proc/thread-self").ok();
    let id: Option<u32> = link.and_then(|link| link.file_name()?.to_str()?.parse().ok());
    let mut threads = threads();
    let id = id.filter(|id| !threads.running.contains_key(id));
    threads.running.extend(id.map(|id| (id, role)));
    Registration(id)
}

impl Drop for Registration {
    fn drop(&mut self) {
        let Some(id) = self.0 else { return };
        let mut threads = threads();
        if let Some(role) = threads.running.remove(&id) {
            threads.ended_ns[role as usize] += of_thread_ns(id).unwrap_or_default();
        }
    }
}

/// Processor time of all registered threads so far, with those that have ended, by role; `None` where the system does not report it
/// (it does on Linux).
#[must_use]
pub fn by_role() -> Option<RoleTimes> {
    let threads = threads();
    if threads.running.is_empty() {
        return None;
    }
    let mut by_role_ns = threads.ended_ns;
    for (&id, &role) in &threads.running {
        by_role_ns[role as usize] += of_thread_ns(id)?;
    }
    Some(RoleTimes(by_role_ns.map(|ns| ns as f64 * 1e-6)))
}

/// Time that all threads of the process have spent on a processor so far, a driver's and ended ones included, milliseconds, to 10 ms;
/// `None` where the system does not report it (it does on Linux).
#[must_use]
pub fn of_process_ms() -> Option<f64> {
    // proc_pid_stat(5): user and system time are fields 14 and 15, in ticks of 1/100 s. Field 2 may have spaces and ends with `)`.
    let stat = fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<u64>().ok();
    Some(10.0 * (ticks()? + ticks()?) as f64)
}

/// Time that a thread of this process has spent on a processor, nanoseconds.
fn of_thread_ns(id: u32) -> Option<u64> {
    let times = fs::read_to_string(format!("/proc/self/task/{id}/schedstat")).ok()?;
    times.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn work() -> u64 {
        (0..20_000_000_u64).fold(1, |hash, i| std::hint::black_box(hash.wrapping_mul(31) ^ i))
    }

    #[test]
    #[cfg_attr(not(target_os = "linux"), ignore = "the system does not report times of processes")]
    fn the_time_of_the_process_has_that_of_threads_that_ended() {
        let before = of_process_ms().expect("a time");
        std::thread::spawn(|| (0..8).map(|_| work()).sum::<u64>()).join().expect("a thread");
        assert!(of_process_ms().expect("a time") >= before + 20.0);
    }

    #[test]
    #[cfg_attr(not(target_os = "linux"), ignore = "the system does not report times of threads")]
    fn only_registered_threads_count_and_ended_ones_stay() {
        start();
        let _registration = register(Role::Device);
        assert!(register(Role::Worker).0.is_none(), "this thread is registered already");
        let before = by_role().expect("a time");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let _registration = register(Role::Worker);
                work();
            });
        });
        let with_one = by_role().expect("a time").since(&before, 1);
        assert!(with_one.of(Role::Worker) > 1.0, "{with_one:?}");
        // Longer than the registered one, and not counted.
        std::thread::scope(|scope| scope.spawn(|| (0..8).map(|_| work()).sum::<u64>()).join())
            .expect("a thread");
        let with_other = by_role().expect("a time").since(&before, 1);
        assert_eq!(with_other.of(Role::Worker), with_one.of(Role::Worker));
        assert!(with_other.total() < 2.0 * with_one.total(), "{with_one:?}, {with_other:?}");
    }
}
