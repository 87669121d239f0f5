//! Labelled pictures of the Moon.
//!
//! One frame comes about like this:
//!
//! 1. [`params::sampler::Config`] gathers defaults, preset, file and `--set`; its `draw` gives [`params::Params`]:
//!    every value of one frame, checked.
//! 2. [`scene::Scene::build`] makes the scene of a seed: meshes, materials, sun, camera; plain data.
//! 3. [`render::Renderer::render`] plans what this camera and this sun need of it, uploads that, and draws: shadow map, visibility,
//!    lighting, which writes colour **and** class id of each sample in one draw, then the resolve of samples to pixels.
//! 4. A [`frame::Frame`] comes back: planes of bytes.
//! 5. [`output`] encodes it and writes whole files.
//!
//! [`dataset`] does this thousands of times, checked and resumable; [`bench`] measures how fast.
//!
//! ```
//! use regolith::{params::Params, scene::Scene};
//!
//! let scene = Scene::build(42, &Params::draw_default(42))?;
//! assert!((75..=114).contains(&scene.rocks.len()));
//! # Ok::<(), regolith::Error>(())
//! ```
//!
//! `params` and `scene` know no GPU, `gpu` knows no Moon; they meet in `render`. `render` and `output` meet in
//! `frame`.

pub mod bench;
pub mod class;
pub mod dataset;
pub mod error;
pub mod export;
pub mod frame;
pub mod gpu;
pub mod lens;
pub mod meta;
pub mod output;
pub mod params;
pub mod random;
pub mod remap;
pub mod render;
pub mod reuse;
pub mod scene;

pub use error::{Error, Result};
