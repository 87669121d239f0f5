//! Labelled images of the Moon.
//!
//! From a seed to the files of one frame:
//!
//! 1. [`params::config::Config`] combines defaults, presets, a file and `--set`; it draws [`params::Params`], every
//!    value of one frame, checked.
//! 2. [`scene::Scene::build`] generates the scene of a seed: meshes, materials, sun, camera. Plain data, no GPU.
//! 3. [`render::Renderer::submit`] plans the frame: what this camera and this sun need, in which level of detail, which
//!    rocks cast shadows into view. Plain data too, uploaded as it is.
//! 4. It rasterises visibility and shadow map, on the device or on the host ([`render::RasterOptions`]).
//! 5. One lighting draw writes radiance **and** class id of every sample; the resolve pass turns samples into pixels.
//! 6. A [`frame::Frame`] is read back: one plane of bytes for colour, one for the classes, one for each annotation.
//! 7. [`output`] encodes it and writes whole files.
//!
//! [`dataset`] does this for thousands of frames, checked and resumable; [`mod@bench`] measures the throughput.
//!
//! ```
//! use regolith::{params::Params, scene::Scene};
//!
//! let scene = Scene::build(42, &Params::draw_default(42))?;
//! assert!((75..=114).contains(&scene.rocks.len()));
//! # Ok::<(), regolith::Error>(())
//! ```
//!
//! `params` and `scene` do not know the GPU, `gpu` does not know the Moon; they meet in `render`. `render` and `output`
//! meet in `frame`.

pub mod bench;
pub mod class;
pub mod cli;
pub mod dataset;
pub mod doctor;
pub mod error;
pub mod export;
pub mod frame;
pub mod gpu;
pub mod host_time;
pub mod input;
pub mod lens;
pub mod meta;
pub mod output;
pub mod params;
pub mod pool;
pub mod random;
pub mod remap;
pub mod render;
pub mod rounding;
pub mod scene;

pub use error::{Error, Result};
