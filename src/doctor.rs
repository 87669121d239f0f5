//! What a machine is, and whether frames rendered on it are right.
//!
//! [`hardware`] looks at the machine without loading a driver; [`findings`] compares that with the adapters that answer. Drivers
//! can crash or hang, so a [`worker`] in a process of its own renders the [`cases`] with one backend and reports each frame as an
//! event. An [`examination`] collects the events of all workers and [`compare`]s the frames with each other and with the
//! [`mod@reference`]; [`markdown`] writes its verdict for people.
//! Must not know: the command line, processes.

pub mod cases;
pub mod compare;
pub mod drivers;
pub mod examination;
pub mod findings;
pub mod hardware;
pub mod markdown;
pub mod planes;
pub mod reference;
pub mod worker;
