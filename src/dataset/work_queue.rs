//! What the threads of a pipeline do next.
//!
//! Workers prepare attempts at frames and finish those that were rendered; one thread renders what is prepared. A frame that was read
//! back is finished before anything else, an attempt that follows a rejected one is prepared before a new frame, and a new frame is
//! started only while few are prepared, few have a scene in memory and the oldest unfinished one is not far behind. So no thread ever
//! waits for room in a queue, and yet the number of frames in memory is bounded.
//! Must not know: how a frame is prepared, rendered or finished.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// The next work of a worker.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Task<Attempt, Raw> {
    /// An attempt to prepare for the device.
    Prepare(Attempt),
    /// A frame that was read back.
    Finish(Raw),
}

/// The largest numbers of frames in a queue.
#[derive(Clone, Copy, Debug)]
pub(super) struct QueueLimits {
    /// Frames that are prepared, or being prepared, before a new one is started.
    pub(super) ready: usize,
    /// Frames that are started after the oldest unfinished one.
    pub(super) ahead: usize,
    /// Attempts that have a scene: prepared, rendered, read back or being finished.
    pub(super) in_memory: usize,
}

/// The queue of a pipeline: indices of frames, attempts at them, prepared attempts, and frames that were read back.
#[derive(Debug)]
pub(super) struct WorkQueue<Indices, Attempt, Prepared, Raw> {
    state: Mutex<State<Indices, Attempt, Prepared, Raw>>,
    changed: Condvar,
    limits: QueueLimits,
}

#[derive(Debug)]
struct State<Indices, Attempt, Prepared, Raw> {
    indices: Indices,
    redraws: VecDeque<Attempt>,
    prepared: VecDeque<Prepared>,
    raw: VecDeque<Raw>,
    /// Attempts that a worker is preparing.
    preparing: usize,
    /// Attempts that have a scene, those that a worker is preparing included.
    in_memory: usize,
    /// Frames that were started, in order, and whether each is finished. The first is not.
    started: VecDeque<(u64, bool)>,
    /// No further frame is started.
    ends: bool,
    /// Nothing further is done.
    closed: bool,
}

impl<Indices: Iterator<Item = u64>, Attempt, Prepared, Raw> WorkQueue<Indices, Attempt, Prepared, Raw> {
    pub(super) fn new(indices: Indices, limits: QueueLimits) -> Self {
        let state = State {
            indices,
            redraws: VecDeque::new(),
            prepared: VecDeque::new(),
            raw: VecDeque::new(),
            preparing: 0,
            in_memory: 0,
            started: VecDeque::new(),
            ends: false,
            closed: false,
        };
        Self { state: Mutex::new(state), changed: Condvar::new(), limits }
    }

    fn lock(&self) -> MutexGuard<'_, State<Indices, Attempt, Prepared, Raw>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the state and wakes the threads that wait for it.
    fn change<T>(&self, change: impl FnOnce(&mut State<Indices, Attempt, Prepared, Raw>) -> T) -> T {
        let result = change(&mut self.lock());
        self.changed.notify_all();
        result
    }

    /// Waits for the next work of a worker; `None` once there will be none. `first` makes the first attempt at a frame of its index; once
    /// `stops` is true no further frame is started.
    pub(super) fn next_task(
        &self,
        stops: impl Fn() -> bool,
        first: impl Fn(u64) -> Attempt,
    ) -> Option<Task<Attempt, Raw>> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some(raw) = state.raw.pop_front() {
                return Some(Task::Finish(raw));
            }
            if let Some(attempt) = state.redraws.pop_front() {
                state.start_preparing();
                return Some(Task::Prepare(attempt));
            }
            let has_room = state.prepared.len() + state.preparing < self.limits.ready
                && state.started.len() < self.limits.ahead
                && state.in_memory < self.limits.in_memory;
            if has_room && !state.ends {
                let next = if stops() { None } else { state.indices.next() };
                if let Some(index) = next {
                    state.started.push_back((index, false));
                    state.start_preparing();
                    return Some(Task::Prepare(first(index)));
                }
                state.ends = true;
                self.changed.notify_all();
            }
            if state.is_done() {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The next prepared attempt. If there is none: waits for one if `waits`, until there will be none.
    pub(super) fn next_prepared(&self, waits: bool) -> Option<Prepared> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some(prepared) = state.prepared.pop_front() {
                self.changed.notify_all();
                return Some(prepared);
            }
            if !waits || state.is_done() {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Adds an attempt that is prepared; a redraw before the others, which wait for nothing.
    pub(super) fn add_prepared(&self, prepared: Prepared, is_redraw: bool) {
        self.change(|state| {
            state.preparing -= 1;
            if is_redraw {
                state.prepared.push_front(prepared);
            } else {
                state.prepared.push_back(prepared);
            }
        });
    }

    /// Adds a frame that was read back.
    pub(super) fn add_raw(&self, raw: Raw) {
        self.change(|state| state.raw.push_back(raw));
    }

    /// Adds the attempt that follows a rejected one, whose scene is gone.
    pub(super) fn add_redraw(&self, attempt: Attempt) {
        self.change(|state| {
            state.in_memory -= 1;
            state.redraws.push_back(attempt);
        });
    }

    /// A frame of an index is finished; where an index was asked for more than once, one of them.
    pub(super) fn finish(&self, index: u64) {
        self.change(|state| {
            state.in_memory -= 1;
            if let Some(frame) = state.started.iter_mut().find(|frame| **frame == (index, false)) {
                frame.1 = true;
            }
            while state.started.front().is_some_and(|(_, is_finished)| *is_finished) {
                state.started.pop_front();
            }
        });
    }

    /// Ends the work of all threads, after an error.
    pub(super) fn close(&self) {
        self.change(|state| state.closed = true);
    }

    /// Closes the queue if the thread that holds the guard panics: the others would wait for ever.
    pub(super) const fn close_on_panic(&self) -> CloseOnPanic<'_, Indices, Attempt, Prepared, Raw> {
        CloseOnPanic(self)
    }
}

impl<Indices, Attempt, Prepared, Raw> State<Indices, Attempt, Prepared, Raw> {
    fn start_preparing(&mut self) {
        self.preparing += 1;
        self.in_memory += 1;
    }

    /// Whether every frame that was started is finished, and no other will be.
    fn is_done(&self) -> bool {
        self.ends && self.started.is_empty()
    }
}

/// See [`WorkQueue::close_on_panic`].
pub(super) struct CloseOnPanic<'a, Indices: Iterator<Item = u64>, Attempt, Prepared, Raw>(
    &'a WorkQueue<Indices, Attempt, Prepared, Raw>,
);

impl<Indices: Iterator<Item = u64>, Attempt, Prepared, Raw> Drop
    for CloseOnPanic<'_, Indices, Attempt, Prepared, Raw>
{
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.close();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Attempts are `(index, number)`; prepared and raw ones the same.
    type Queue = WorkQueue<std::ops::Range<u64>, (u64, u32), (u64, u32), (u64, u32)>;

    const LIMITS: QueueLimits = QueueLimits { ready: 2, ahead: 6, in_memory: 5 };

    fn task(queue: &Queue) -> Option<Task<(u64, u32), (u64, u32)>> {
        queue.next_task(|| false, |index| (index, 0))
    }

    #[test]
    fn rendered_frames_come_before_redraws_and_redraws_before_new_frames() {
        let queue = Queue::new(0..9, LIMITS);
        assert_eq!(task(&queue), Some(Task::Prepare((0, 0))));
        assert_eq!(task(&queue), Some(Task::Prepare((1, 0))));
        queue.add_prepared((0, 0), false);
        queue.add_redraw((7, 1));
        queue.add_raw((8, 0));
        assert_eq!(task(&queue), Some(Task::Finish((8, 0))));
        assert_eq!(task(&queue), Some(Task::Prepare((7, 1))), "though enough are prepared");
        queue.add_prepared((7, 1), true);
        assert_eq!(queue.next_prepared(false), Some((7, 1)));
        assert_eq!(queue.next_prepared(false), Some((0, 0)));
        assert_eq!(queue.next_prepared(false), None, "frame 1 is not prepared yet");
        assert_eq!(task(&queue), Some(Task::Prepare((2, 0))));
    }

    #[test]
    fn all_frames_are_made_by_any_number_of_threads_and_few_are_in_memory() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        for threads in [1, 2, 5] {
            let queue = Queue::new(0..200, LIMITS);
            let (made, alive, most) = (Mutex::new(Vec::new()), AtomicUsize::new(0), AtomicUsize::new(0));
            std::thread::scope(|scope| {
                for _ in 0..threads {
                    scope.spawn(|| {
                        while let Some(task) = task(&queue) {
                            match task {
                                Task::Prepare((index, number)) => {
                                    if number == 0 {
                                        most.fetch_max(
                                            1 + alive.fetch_add(1, Ordering::SeqCst),
                                            Ordering::SeqCst,
                                        );
                                    }
                                    queue.add_prepared((index, number), number > 0);
                                }
                                // Every third frame is redrawn four times.
                                Task::Finish((index, number)) if index % 3 == 0 && number < 4 => {
                                    queue.add_redraw((index, number + 1));
                                }
                                Task::Finish((index, _)) => {
                                    made.lock().expect("a list").push(index);
                                    alive.fetch_sub(1, Ordering::SeqCst);
                                    queue.finish(index);
                                }
                            }
                        }
                    });
                }
                let mut in_flight = VecDeque::new();
                loop {
                    let next =
                        if in_flight.len() < 2 { queue.next_prepared(in_flight.is_empty()) } else { None };
                    match next.map_or_else(
                        || in_flight.pop_front().map(|raw| (raw, true)),
                        |next| Some((next, false)),
                    ) {
                        Some((raw, true)) => queue.add_raw(raw),
                        Some((next, false)) => in_flight.push_back(next),
                        None => break,
                    }
                }
            });
            let mut made = made.into_inner().expect("a list");
            made.sort_unstable();
            assert_eq!(made, (0..200).collect::<Vec<_>>(), "{threads} threads");
            assert!(most.into_inner() <= LIMITS.ahead, "{threads} threads");
        }
    }

    #[test]
    fn a_new_frame_waits_until_few_have_a_scene() {
        let queue = Queue::new(0..9, QueueLimits { ready: 9, ahead: 9, in_memory: 2 });
        for index in 0..2 {
            assert_eq!(task(&queue), Some(Task::Prepare((index, 0))));
            queue.add_prepared((index, 0), false);
            assert_eq!(queue.next_prepared(false), Some((index, 0)));
        }
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| task(&queue));
            std::thread::sleep(std::time::Duration::from_millis(20));
            assert!(!waiting.is_finished(), "two frames are rendered");
            // A rejected attempt leaves room, which the next one takes.
            queue.add_redraw((0, 1));
            assert_eq!(waiting.join().expect("no panic"), Some(Task::Prepare((0, 1))));
            let waiting = scope.spawn(|| task(&queue));
            queue.finish(1);
            assert_eq!(waiting.join().expect("no panic"), Some(Task::Prepare((2, 0))));
        });
    }

    #[test]
    fn a_stop_finishes_what_was_started_and_an_error_ends_everything() {
        let queue = Queue::new(0..9, LIMITS);
        assert_eq!(task(&queue), Some(Task::Prepare((0, 0))));
        queue.add_prepared((0, 0), false);
        assert_eq!(queue.next_prepared(true), Some((0, 0)));
        queue.add_raw((0, 0));
        assert_eq!(queue.next_task(|| true, |index| (index, 0)), Some(Task::Finish((0, 0))));
        queue.add_redraw((0, 1));
        assert_eq!(queue.next_task(|| true, |index| (index, 0)), Some(Task::Prepare((0, 1))));
        queue.finish(0);
        assert_eq!(queue.next_task(|| true, |index| (index, 0)), None);
        assert_eq!(queue.next_prepared(true), None);

        let queue = Queue::new(0..9, LIMITS);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| queue.next_prepared(true));
            let panicking = scope.spawn(|| {
                let _guard = queue.close_on_panic();
                std::panic::resume_unwind(Box::new("a defect"));
            });
            assert!(panicking.join().is_err());
            assert_eq!(waiting.join().expect("no panic"), None);
        });
        assert_eq!(task(&queue), None);
    }
}
