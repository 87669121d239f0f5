//! A scene that is built once and rendered from many poses.

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use regolith::dataset::frame_stream::{posed, render_scene};
use regolith::dataset::plan::Plan;
use regolith::export::{self, Detail, Format, Stage};
use regolith::params::Params;

use crate::convert::{self, PyFrame};
use crate::engine::Engine;
use crate::errors::raised;

/// A scene with the values of its knobs.
#[pyclass(frozen)]
pub(crate) struct Scene {
    plan: Plan,
    seed: u64,
    scene: regolith::scene::Scene,
    params: Params,
}

impl Scene {
    pub(crate) fn new(plan: Plan, seed: u64, (scene, params): (regolith::scene::Scene, Params)) -> Self {
        Self { plan, seed, scene, params }
    }
}

#[pymethods]
impl Scene {
    /// A frame; `set` is TOML of knobs of camera and sun that differ from those of the scene.
    fn render<'py>(
        &self,
        py: Python<'py>,
        engine: &Engine,
        set: &str,
        eye_z_m: Option<f32>,
    ) -> PyResult<PyFrame<'py>> {
        let frame = engine.on_pool(py, |renderer| {
            let posed = posed(&self.plan, self.seed, (&self.scene, &self.params), set, eye_z_m)?;
            render_scene(&self.plan, renderer, self.seed, posed)
        });
        convert::frame(py, frame?)
    }

    /// Height of the ground at a point, metres.
    fn ground_height(&self, x_m: f32, y_m: f32) -> f32 {
        self.scene.terrain.height_at([x_m, y_m].into())
    }

    /// The scene as a file: npz, glb, usda or usdc.
    fn export<'py>(&self, py: Python<'py>, format: &str, drawn: bool) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = || -> regolith::Result<Vec<u8>> {
            let format = Format::from_path(std::path::Path::new(&format!("scene.{format}")))?;
            let knobs = self.params.to_json();
            let detail = if drawn { Detail::Drawn } else { Detail::Authored };
            let settings = &self.plan.settings;
            let stage = Stage { scene: &self.scene, seed: self.seed, knobs: &knobs, settings, detail };
            export::export(&stage, format)
        };
        Ok(PyBytes::new(py, &raised(py, py.detach(bytes))?))
    }
}
