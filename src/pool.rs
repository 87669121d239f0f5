//! What threads share: a pool of buffers, by which scenes and frames reuse the memory of earlier ones, which saves page faults and zeroing;
//! and tables that are made once.
//!
//! Nothing here waits for another thread. In a process that was forked from another, that thread may have been left behind there, and what
//! it began is never finished.
//!
//! Must not know: what the buffers hold.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::hint;
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, OnceLock, TryLockError};
use std::thread;

use bytemuck::Pod;

/// Minimum size of a pooled buffer, bytes: for smaller ones the allocator is as fast.
const MIN_BYTES: usize = 1 << 10;
/// Capacity of the shared pool for each core, bytes. That for two holds more than a nominal scene.
const MAX_BYTES_PER_CORE: usize = 8 << 20;
/// Capacity of a thread's own pool, bytes: about what stays in its core's cache.
const MAX_OWN_BYTES: usize = 1 << 20;
/// How often a thread tries to get the shared pool: for longer than any other keeps it while both run.
const MAX_TRIES: usize = 1000;

/// Unused buffers, shared by all threads. When it is full, those that have been unused the longest are freed: otherwise it would
/// fill with sizes that no scene needs any more.
static SHARED: Mutex<Pool> = Mutex::new(Pool::new());
thread_local! {
    /// Unused buffers of this thread.
    static OWN: RefCell<Pool> = const { RefCell::new(Pool::new()) };
}

/// Unused buffers.
struct Pool {
    bytes: usize,
    /// Number of buffers that were added so far.
    added: u64,
    /// Buffers by element type and capacity, the oldest first.
    lists: BTreeMap<(TypeId, usize), VecDeque<Unused>>,
}

struct Unused {
    /// Number of buffers that were added before it.
    number: u64,
    bytes: usize,
    list: Box<dyn Any + Send>,
}

impl Pool {
    const fn new() -> Self {
        Self { bytes: 0, added: 0, lists: BTreeMap::new() }
    }

    /// The buffer of this capacity that was added last.
    fn take<T: Value>(&mut self, capacity: usize) -> Option<Vec<T>> {
        let unused = self.lists.get_mut(&(TypeId::of::<T>(), capacity))?.pop_back()?;
        self.bytes -= unused.bytes;
        unused.list.downcast().ok().map(|list| *list)
    }

    /// Adds a buffer, or returns it if the pool would hold more than `max_bytes`.
    fn put<T: Value>(&mut self, list: Vec<T>, max_bytes: usize) -> Option<Vec<T>> {
        let (capacity, bytes) = (list.capacity(), list.capacity() * size_of::<T>());
        if self.bytes + bytes > max_bytes {
            return Some(list);
        }
        let unused = Unused { number: self.added, bytes, list: Box::new(list) };
        self.added += 1;
        self.bytes += bytes;
        self.lists.entry((TypeId::of::<T>(), capacity)).or_default().push_back(unused);
        None
    }

    /// Removes the buffers that have been unused the longest, until one of `bytes` has room among `max_bytes`.
    fn make_room(&mut self, bytes: usize, max_bytes: usize) -> Vec<Unused> {
        let mut removed = Vec::new();
        while self.bytes + bytes > max_bytes {
            let lists = self.lists.values_mut().filter(|list| !list.is_empty());
            let oldest = lists.min_by_key(|list| list.front().map(|unused| unused.number));
            let Some(unused) = oldest.and_then(VecDeque::pop_front) else { break };
            self.bytes -= unused.bytes;
            removed.push(unused);
        }
        removed
    }
}

/// The shared pool, unless another thread keeps it for long.
fn shared() -> Option<MutexGuard<'static, Pool>> {
    for _ in 0..MAX_TRIES {
        match SHARED.try_lock() {
            Ok(pool) => return Some(pool),
            Err(TryLockError::Poisoned(error)) => return Some(error.into_inner()),
            Err(TryLockError::WouldBlock) => hint::spin_loop(),
        }
    }
    None
}

/// Capacity of the shared pool, bytes.
fn max_bytes() -> usize {
    static MAX_BYTES: OnceLock<usize> = OnceLock::new();
    let cores = || thread::available_parallelism().map_or(1, usize::from);
    *made_once(&MAX_BYTES, || MAX_BYTES_PER_CORE * cores().max(2))
}

/// What is shared, made first if there is none yet; threads that come at the same time all make it.
pub fn made_once<T>(shared: &'static OnceLock<T>, make: impl FnOnce() -> T) -> &'static T {
    shared.get().unwrap_or_else(|| {
        let made = make();
        shared.get_or_init(|| made)
    })
}

/// An element type for which any bit pattern is valid.
pub trait Value: Pod + Send {}
impl<T: Pod + Send> Value for T {}

/// A fixed-length buffer whose memory returns to the pool when dropped.
#[derive(Debug, PartialEq)]
pub struct PooledVec<T: Value>(Vec<T>);

impl<T: Value> PooledVec<T> {
    /// A buffer with arbitrary contents: whatever its memory held before. Similar lengths share memory.
    #[must_use]
    pub fn unspecified(len: usize) -> Self {
        Self::with_capacity(len, capacity_for(len))
    }

    /// The same for one of a few lengths that recur: with none but the memory that it needs.
    #[must_use]
    pub fn recurring(len: usize) -> Self {
        Self::with_capacity(len, len)
    }

    fn with_capacity(len: usize, capacity: usize) -> Self {
        if capacity * size_of::<T>() < MIN_BYTES {
            return Self(vec![T::zeroed(); len]);
        }
        let own = OWN.try_with(|own| own.borrow_mut().take(capacity)).ok().flatten();
        let mut list =
            own.or_else(|| shared()?.take(capacity)).unwrap_or_else(|| Vec::with_capacity(capacity));
        list.resize(len, T::zeroed());
        Self(list)
    }

    /// A buffer filled with one value.
    #[must_use]
    pub fn filled(len: usize, value: T) -> Self {
        let mut values = Self::unspecified(len);
        values.fill(value);
        values
    }
}

/// Capacity for a length, rounded up to one of four sizes per octave, so that similar lengths share buffers.
const fn capacity_for(len: usize) -> usize {
    let step = (len / 8 + 1).next_power_of_two();
    len.next_multiple_of(step)
}

impl<T: Value> Drop for PooledVec<T> {
    fn drop(&mut self) {
        let list = std::mem::take(&mut self.0);
        if list.capacity() * size_of::<T>() < MIN_BYTES {
            return;
        }
        // While a thread ends its own pool is gone, and the buffer is freed.
        let left = OWN.try_with(|own| own.borrow_mut().put(list, MAX_OWN_BYTES)).ok().flatten();
        if let Some(list) = left
            && let Some(mut shared) = shared()
        {
            let removed = shared.make_room(list.capacity() * size_of::<T>(), max_bytes());
            let too_large = shared.put(list, max_bytes());
            // Freed once others may use the pool.
            drop(shared);
            drop((removed, too_large));
        }
    }
}

impl<T: Value> Deref for PooledVec<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T: Value> DerefMut for PooledVec<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

impl<'a, T: Value> IntoIterator for &'a PooledVec<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<'a, T: Value> IntoIterator for &'a mut PooledVec<T> {
    type Item = &'a mut T;
    type IntoIter = std::slice::IterMut<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter_mut()
    }
}

impl<T: Value> Clone for PooledVec<T> {
    fn clone(&self) -> Self {
        let mut copy = Self::with_capacity(self.len(), self.0.capacity());
        copy.copy_from_slice(self);
        copy
    }
}

impl<T: Value> From<&[T]> for PooledVec<T> {
    fn from(values: &[T]) -> Self {
        let mut copies = Self::unspecified(values.len());
        copies.copy_from_slice(values);
        copies
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::time::Duration;

    use super::*;

    #[test]
    fn capacity_exceeds_the_length_by_at_most_a_quarter() {
        let mut capacities: Vec<usize> = (0..100_000).map(capacity_for).collect();
        for (len, capacity) in capacities.iter().enumerate() {
            assert!(*capacity >= len && *capacity <= len + len / 4 + 1, "{capacity} for {len}");
        }
        capacities.dedup();
        assert!(capacities.len() < 100, "{} capacities", capacities.len());
    }

    #[test]
    fn a_recurring_length_has_no_spare_capacity_and_finds_its_memory_again() {
        let first = PooledVec::<f32>::recurring(642);
        let copy = first.clone();
        assert_eq!([first.0.capacity(), copy.0.capacity()], [642; 2]);
        let address = copy.as_ptr();
        drop(first);
        drop(copy);
        assert_eq!(PooledVec::<f32>::recurring(642).as_ptr(), address);
    }

    #[test]
    fn small_buffers_are_not_pooled() {
        let pooled = || OWN.with_borrow(|own| own.lists.values().map(VecDeque::len).sum::<usize>());
        for len in [0, 1, MIN_BYTES / size_of::<f32>() / 2] {
            drop(PooledVec::filled(len, 1.0_f32));
            assert_eq!(pooled(), 0, "{len} values");
        }
        drop(PooledVec::filled(MIN_BYTES / size_of::<f32>(), 1.0_f32));
        assert_eq!(pooled(), 1);
    }

    #[test]
    fn a_full_pool_frees_what_was_unused_the_longest() {
        let mut pool = Pool::new();
        for len in [100, 300, 200, 100] {
            assert!(pool.put(vec![0_u8; len], 700).is_none());
        }
        assert!(pool.put(vec![0_u8; 1], 700).is_some(), "it is full");
        let removed: Vec<usize> = pool.make_room(350, 700).iter().map(|unused| unused.bytes).collect();
        assert_eq!((removed, pool.bytes), (vec![100, 300], 300));
        assert_eq!(pool.take::<u8>(300).map(|list| list.len()), None, "it was removed");
        assert_eq!(pool.take::<u8>(100).map(|list| list.len()), Some(100));
        assert_eq!(pool.take::<u8>(100).map(|list| list.len()), None);
        assert_eq!(pool.take::<i8>(200).map(|list| list.len()), None, "another type");
        assert_eq!(pool.make_room(1000, 700).len(), 1);
        assert_eq!(pool.bytes, 0);
        assert_eq!(pool.make_room(1000, 700).len(), 0, "it is empty");
    }

    #[test]
    fn a_thread_that_keeps_the_shared_pool_stops_no_other() {
        let kept = shared();
        assert!(kept.is_some());
        let len = MAX_OWN_BYTES + 1;
        let (sender, receiver) = mpsc::channel();
        thread::spawn(move || {
            drop(PooledVec::filled(len, 1_u8));
            sender.send(PooledVec::filled(len, 2_u8).len())
        });
        let other = receiver.recv_timeout(Duration::from_secs(60));
        drop(kept);
        assert_eq!(other, Ok(len));
    }

    #[test]
    fn what_another_thread_never_finishes_is_made_here() {
        static TABLE: OnceLock<u32> = OnceLock::new();
        let (making, made) = mpsc::channel();
        let (end, ended) = mpsc::channel::<()>();
        let other = thread::spawn(move || {
            *made_once(&TABLE, || {
                making.send(()).expect("a receiver");
                ended.recv().expect_err("nothing is sent");
                1
            })
        });
        made.recv().expect("a start");
        assert_eq!(made_once(&TABLE, || 2), &2);
        drop(end);
        assert_eq!(other.join().expect("an end"), 2, "what was there first is shared");
    }

    #[test]
    fn memory_is_reused_and_clones_are_independent() {
        let len = 123_457;
        let mut first = PooledVec::filled(len, 7.0_f32);
        let address = first.as_ptr();
        let second = first.clone();
        assert!(second == first && second.as_ptr() != address);
        first[len - 1] = 8.0;
        assert_eq!((second[len - 1], first[len - 1]), (7.0, 8.0));
        drop(second);
        drop(first);
        // Slightly larger, of the same capacity.
        let again = PooledVec::<f32>::unspecified(len + 2);
        assert_eq!(again.len(), len + 2);
        assert_eq!(again.as_ptr(), address, "the buffer last dropped on this thread is taken first");
    }
}
