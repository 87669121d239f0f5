//! The one integration binary: the real program and the renderer on a CPU driver.

mod architecture;
mod cli;
mod closed_form;
mod determinism;
mod golden;
mod labels;
mod scene_statistics;
mod support;
