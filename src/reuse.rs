//! Memory that is used again: a scene is made in that of the scenes before it, and so is a picture of it.
//!
//! Must not know: what lies in it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::{Pod, cast_slice, cast_slice_mut};

/// What memory is made of, so that it is aligned for anything that lies in it.
type Word = u128;

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
    /// By how many words each piece has.
    of_words: BTreeMap<usize, Vec<Vec<Word>>>,
}

impl Spare {
    const fn new() -> Self {
        Self { bytes: 0, of_words: BTreeMap::new() }
    }

    fn take(&mut self, words: usize) -> Option<Vec<Word>> {
        let piece = self.of_words.get_mut(&words)?.pop()?;
        self.bytes -= size_of_val(&piece[..]);
        Some(piece)
    }

    /// Gives it back if there would be more than `most_bytes`.
    fn keep(&mut self, piece: Vec<Word>, most_bytes: usize) -> Option<Vec<Word>> {
        let bytes = size_of_val(&piece[..]);
        if self.bytes + bytes > most_bytes {
            return Some(piece);
        }
        self.bytes += bytes;
        self.of_words.entry(piece.len()).or_default().push(piece);
        None
    }
}

fn shared() -> MutexGuard<'static, Spare> {
    SPARE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Some values, whose memory is used again after them.
pub struct Reused<T: Pod> {
    words: Vec<Word>,
    len: usize,
    values: PhantomData<T>,
}

impl<T: Pod> Reused<T> {
    /// So many values, which may be any: those of what lay there before.
    #[must_use]
    pub fn of_any(len: usize) -> Self {
        let words = size_for((len * size_of::<T>()).div_ceil(size_of::<Word>()));
        let own = OWN.try_with(|own| own.borrow_mut().take(words)).ok().flatten();
        let piece = own.or_else(|| shared().take(words));
        Self { words: piece.unwrap_or_else(|| vec![0; words]), len, values: PhantomData }
    }

    /// So many of one value.
    #[must_use]
    pub fn filled(len: usize, value: T) -> Self {
        let mut values = Self::of_any(len);
        values.fill(value);
        values
    }
}

/// Words of the piece that so many are taken from: one of four sizes an octave, so that what differs a little shares them.
const fn size_for(words: usize) -> usize {
    let step = (words / 8 + 1).next_power_of_two();
    words.next_multiple_of(step)
}

impl<T: Pod> Drop for Reused<T> {
    fn drop(&mut self) {
        let words = std::mem::take(&mut self.words);
        // A thread that ends has nothing of its own any more, and lets go of this.
        let left = OWN.try_with(|own| own.borrow_mut().keep(words, MOST_OWN_BYTES)).ok().flatten();
        if let Some(words) = left {
            drop(shared().keep(words, MOST_BYTES));
        }
    }
}

impl<T: Pod> Deref for Reused<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        let bytes: &[u8] = cast_slice(&self.words);
        cast_slice(&bytes[..self.len * size_of::<T>()])
    }
}

impl<T: Pod> DerefMut for Reused<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        let bytes: &mut [u8] = cast_slice_mut(&mut self.words);
        cast_slice_mut(&mut bytes[..self.len * size_of::<T>()])
    }
}

impl<'a, T: Pod> IntoIterator for &'a Reused<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<'a, T: Pod> IntoIterator for &'a mut Reused<T> {
    type Item = &'a mut T;
    type IntoIter = std::slice::IterMut<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter_mut()
    }
}

impl<T: Pod> Clone for Reused<T> {
    fn clone(&self) -> Self {
        Self::from(&self[..])
    }
}

impl<T: Pod> From<&[T]> for Reused<T> {
    fn from(values: &[T]) -> Self {
        let mut copies = Self::of_any(values.len());
        copies.copy_from_slice(values);
        copies
    }
}

impl<T: Pod + std::fmt::Debug> std::fmt::Debug for Reused<T> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self[..].fmt(formatter)
    }
}

impl<T: Pod + PartialEq> PartialEq for Reused<T> {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_enough_and_at_most_a_quarter_more() {
        let mut sizes: Vec<usize> = (0..100_000).map(size_for).collect();
        for (words, size) in sizes.iter().enumerate() {
            assert!(*size >= words && *size <= words + words / 4 + 1, "{size} for {words}");
        }
        sizes.dedup();
        assert!(sizes.len() < 100, "{} sizes", sizes.len());
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
        // As another type, and for a few more.
        let again = Reused::<[u8; 4]>::of_any(len + 2);
        assert_eq!(again.len(), len + 2);
        assert_eq!(again.as_ptr().cast(), address, "what was left last on this thread is taken first");
    }
}
