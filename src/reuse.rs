//! Memory that is used again: a scene is made in that of the scenes before it, and so is a picture of it.
//!
//! Must not know: what lies in it.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::Pod;

/// Least that is worth it, bytes: what is smaller would be outnumbered by what is kept of it.
const LEAST_BYTES: usize = 1 << 10;
/// Most that is left unused for what may come, bytes.
const MOST_BYTES: usize = 128 << 20;
/// Most of that which a thread keeps to itself, as it may be in its core's cache.
const MOST_OWN_BYTES: usize = 1 << 20;

/// What nothing uses.
static SPARE: Mutex<Spare> = Mutex::new(Spare::new());
thread_local! {
    /// The same, of this thread.
    static OWN: RefCell<Spare> = const { RefCell::new(Spare::new()) };
}

struct Spare {
    bytes: usize,
    /// Lists by what they are of and how many they have room for.
    lists: BTreeMap<(TypeId, usize), Vec<Box<dyn Any + Send>>>,
}

impl Spare {
    const fn new() -> Self {
        Self { bytes: 0, lists: BTreeMap::new() }
    }

    fn take<T: Value>(&mut self, room: usize) -> Option<Vec<T>> {
        let list = self.lists.get_mut(&(TypeId::of::<T>(), room))?.pop()?;
        self.bytes -= room * size_of::<T>();
        list.downcast().ok().map(|list| *list)
    }

    /// Gives it back if there would be more than `most_bytes`.
    fn keep<T: Value>(&mut self, list: Vec<T>, most_bytes: usize) -> Option<Vec<T>> {
        let (room, bytes) = (list.capacity(), list.capacity() * size_of::<T>());
        if self.bytes + bytes > most_bytes {
            return Some(list);
        }
        self.bytes += bytes;
        self.lists.entry((TypeId::of::<T>(), room)).or_default().push(Box::new(list));
        None
    }
}

fn shared() -> MutexGuard<'static, Spare> {
    SPARE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A value that may be of any bits.
pub trait Value: Pod + Send {}
impl<T: Pod + Send> Value for T {}

/// Some values, whose memory is used again after them.
#[derive(Debug, PartialEq)]
pub struct Reused<T: Value>(Vec<T>);

impl<T: Value> Reused<T> {
    /// So many values, which may be any: those of what lay there before.
    #[must_use]
    pub fn of_any(len: usize) -> Self {
        let room = room_for(len);
        let own = OWN.try_with(|own| own.borrow_mut().take(room)).ok().flatten();
        let mut list = own.or_else(|| shared().take(room)).unwrap_or_else(|| Vec::with_capacity(room));
        list.resize(len, T::zeroed());
        Self(list)
    }

    /// So many of one value.
    #[must_use]
    pub fn filled(len: usize, value: T) -> Self {
        let mut values = Self::of_any(len);
        values.fill(value);
        values
    }
}

/// Room that is made for so many values: one of four sizes an octave, so that what differs a little shares them.
const fn room_for(len: usize) -> usize {
    let step = (len / 8 + 1).next_power_of_two();
    len.next_multiple_of(step)
}

impl<T: Value> Drop for Reused<T> {
    fn drop(&mut self) {
        let list = std::mem::take(&mut self.0);
        if list.capacity() * size_of::<T>() < LEAST_BYTES {
            return;
        }
        // A thread that ends has nothing of its own any more, and lets go of this.
        let left = OWN.try_with(|own| own.borrow_mut().keep(list, MOST_OWN_BYTES)).ok().flatten();
        if let Some(list) = left {
            drop(shared().keep(list, MOST_BYTES));
        }
    }
}

impl<T: Value> Deref for Reused<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T: Value> DerefMut for Reused<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

impl<'a, T: Value> IntoIterator for &'a Reused<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<'a, T: Value> IntoIterator for &'a mut Reused<T> {
    type Item = &'a mut T;
    type IntoIter = std::slice::IterMut<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter_mut()
    }
}

impl<T: Value> Clone for Reused<T> {
    fn clone(&self) -> Self {
        Self::from(&self[..])
    }
}

impl<T: Value> From<&[T]> for Reused<T> {
    fn from(values: &[T]) -> Self {
        let mut copies = Self::of_any(values.len());
        copies.copy_from_slice(values);
        copies
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_enough_and_at_most_a_quarter_more() {
        let mut rooms: Vec<usize> = (0..100_000).map(room_for).collect();
        for (len, room) in rooms.iter().enumerate() {
            assert!(*room >= len && *room <= len + len / 4 + 1, "{room} for {len}");
        }
        rooms.dedup();
        assert!(rooms.len() < 100, "{} rooms", rooms.len());
    }

    #[test]
    fn what_is_small_or_empty_is_not_hoarded() {
        let kept = || OWN.with_borrow(|own| own.lists.values().map(Vec::len).sum::<usize>());
        for len in [0, 1, LEAST_BYTES / size_of::<f32>() / 2] {
            drop(Reused::filled(len, 1.0_f32));
            assert_eq!(kept(), 0, "{len} values");
        }
        drop(Reused::filled(LEAST_BYTES / size_of::<f32>(), 1.0_f32));
        assert_eq!(kept(), 1);
    }

    #[test]
    fn memory_comes_back_and_values_are_their_owners() {
        let len = 123_457;
        let mut first = Reused::filled(len, 7.0_f32);
        let address = first.as_ptr();
        let second = first.clone();
        assert!(second == first && second.as_ptr() != address);
        first[len - 1] = 8.0;
        assert_eq!((second[len - 1], first[len - 1]), (7.0, 8.0));
        drop(second);
        drop(first);
        // For a few more.
        let again = Reused::<f32>::of_any(len + 2);
        assert_eq!(again.len(), len + 2);
        assert_eq!(again.as_ptr(), address, "what was left last on this thread is taken first");
    }
}
