//! Thousands of checked frames in a folder that survives interruption at any moment.
//!
//! Workers build scenes and plan frames, one thread renders them, and the workers post-process and encode; a frame that breaks a rule
//! goes back to them:
//!
//! ```text
//! indices -> packets (workers) -> frames (one device) -> files (workers) -> line of frames.jsonl
//!               ^                                           |
//!               +---------------- redraws ------------------+
//! ```
//!
//! [`plan`] says what frame i is, [`rules`] which frames are accepted, [`pipeline`] renders them, [`log`] knows which are
//! finished, and [`merge`] completes the folder.
//! Must not know: the command line.

pub mod add_outputs;
pub mod attempt;
mod contact_sheet;
pub mod convert;
mod data_card;
mod digest;
mod frame_image;
pub mod frame_stream;
pub mod gate;
mod histograms;
mod in_order;
pub mod lock;
pub mod log;
pub mod log_writer;
pub mod manifest;
pub mod merge;
pub mod pipeline;
pub mod plan;
pub mod pose;
#[cfg(test)]
mod power_cut;
pub mod rules;
pub mod run;
pub mod totals;
pub mod verify;
mod work_queue;

pub use frame_stream::{FrameInMemory, FrameStream, render_in_memory};
pub use pipeline::{Concurrency, cores, render_frames};
pub use run::{Progress, run, stream};
