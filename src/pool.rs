//! A pool of buffers: scenes and frames reuse the memory of earlier ones, which saves page faults and zeroing.
//!
//! Must not know: what the buffers hold.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::Pod;

/// Minimum size of a pooled buffer, bytes: for smaller ones the allocator is as fast.
const MIN_BYTES: usize = 1 << 10;
/// Capacity of the shared pool, bytes.
const MAX_BYTES: usize = 128 << 20;
/// Capacity of a thread's own pool, bytes: about what stays in its core's cache.
const MAX_OWN_BYTES: usize = 1 << 20;

/// Unused buffers, shared by all threads.
static SHARED: Mutex<Pool> = Mutex::new(Pool::new());
thread_local! {
    /// Unused buffers of this thread.
    static OWN: RefCell<Pool> = const { RefCell::new(Pool::new()) };
}

struct Pool {
    bytes: usize,
    /// Buffers by element type and capacity.
    lists: BTreeMap<(TypeId, usize), Vec<Box<dyn Any + Send>>>,
}

impl Pool {
    const fn new() -> Self {
        Self { bytes: 0, lists: BTreeMap::new() }
    }

    fn take<T: Value>(&mut self, capacity: usize) -> Option<Vec<T>> {
        let list = self.lists.get_mut(&(TypeId::of::<T>(), capacity))?.pop()?;
        self.bytes -= capacity * size_of::<T>();
        list.downcast().ok().map(|list| *list)
    }

    /// Adds a buffer, or returns it if the pool would hold more than `max_bytes`.
    fn put<T: Value>(&mut self, list: Vec<T>, max_bytes: usize) -> Option<Vec<T>> {
        let (capacity, bytes) = (list.capacity(), list.capacity() * size_of::<T>());
        if self.bytes + bytes > max_bytes {
            return Some(list);
        }
        self.bytes += bytes;
        self.lists.entry((TypeId::of::<T>(), capacity)).or_default().push(Box::new(list));
        None
    }
}

fn shared() -> MutexGuard<'static, Pool> {
    SHARED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An element type for which any bit pattern is valid.
pub trait Value: Pod + Send {}
impl<T: Pod + Send> Value for T {}

/// A fixed-length buffer whose memory returns to the pool when dropped.
#[derive(Debug, PartialEq)]
pub struct PooledVec<T: Value>(Vec<T>);

impl<T: Value> PooledVec<T> {
    /// A buffer with arbitrary contents: whatever its memory held before.
    #[must_use]
    pub fn unspecified(len: usize) -> Self {
        let capacity = capacity_for(len);
        let own = OWN.try_with(|own| own.borrow_mut().take(capacity)).ok().flatten();
        let mut list =
            own.or_else(|| shared().take(capacity)).unwrap_or_else(|| Vec::with_capacity(capacity));
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
        if let Some(list) = left {
            drop(shared().put(list, MAX_BYTES));
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
        Self::from(&self[..])
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
    fn small_buffers_are_not_pooled() {
        let pooled = || OWN.with_borrow(|own| own.lists.values().map(Vec::len).sum::<usize>());
        for len in [0, 1, MIN_BYTES / size_of::<f32>() / 2] {
            drop(PooledVec::filled(len, 1.0_f32));
            assert_eq!(pooled(), 0, "{len} values");
        }
        drop(PooledVec::filled(MIN_BYTES / size_of::<f32>(), 1.0_f32));
        assert_eq!(pooled(), 1);
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
