//! The integration tests, in one binary: the command line and the renderer, on a CPU driver.

#![allow(clippy::disallowed_methods, reason = "expected values may use std's functions")]

mod add_outputs;
mod architecture;
mod backends;
mod cli;
mod closed_form;
mod dataset;
mod dataset_locks;
mod dataset_masks;
mod dataset_paths;
mod determinism;
mod docs;
mod doctor;
mod environment;
mod export;
mod exposure;
mod far_field;
mod formats;
mod frame_stream;
mod fuzz;
mod golden;
mod horizon;
mod hostile;
mod label_policy;
mod labels;
mod language;
mod mutation;
mod presets;
mod process;
mod raster;
mod rock_shapes;
mod rocks_in_soil;
mod rover;
mod scene_statistics;
mod soil_detail;
mod sun;
mod support;
mod surface;
mod surface_light;
mod truth;
mod verify;
