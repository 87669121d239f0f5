//! Adapters, knobs, presets and outputs as plain tuples.

use pyo3::prelude::*;
use regolith::error::nearest;
use regolith::gpu::adapter;
use regolith::output::OUTPUTS;
use regolith::params::{KNOBS, Kind, Stage, presets as shipped};

use crate::ending;
use crate::errors::{raised, refused};

/// Name, kind, backend and driver of each adapter, best first.
#[pyfunction]
pub(crate) fn adapters(py: Python<'_>) -> PyResult<Vec<(String, &'static str, String, String)>> {
    let _working = ending::working(py);
    let infos = raised(py, py.detach(adapter::list))?;
    Ok(infos
        .into_iter()
        .map(|info| {
            let driver = format!("{} {}", info.driver, info.driver_info).trim().to_owned();
            (info.name.clone(), adapter::kind(&info), info.backend.to_string(), driver)
        })
        .collect())
}

/// A knob: name, unit, range of a number, default, help, allowed texts.
type KnobRow = (&'static str, &'static str, Option<[f64; 2]>, String, &'static str, Vec<&'static str>);

/// The knobs of a stage.
#[pyfunction]
pub(crate) fn knobs(py: Python<'_>, stage: &str) -> PyResult<Vec<KnobRow>> {
    let stage = Stage::from_name(stage).ok_or_else(|| {
        let names = Stage::ALL.map(|(_, name)| name);
        refused(py, "stage", stage, &names.join(", "), nearest(stage, names))
    })?;
    let rows = KNOBS.iter().filter(|info| info.is_of(stage)).map(|info| {
        let (range, texts) = match info.kind {
            Kind::Text(texts) => (None, texts.to_vec()),
            Kind::Number | Kind::Integer | Kind::Rgb => (Some(info.range), Vec::new()),
        };
        (info.name, info.unit, range, info.default_on(stage).to_string(), info.doc, texts)
    });
    Ok(rows.collect())
}

/// Name and description of each preset.
#[pyfunction]
pub(crate) fn presets() -> Vec<(&'static str, &'static str)> {
    let described = |(name, _)| (name, shipped::preset_description(name).unwrap_or_default());
    shipped::presets().into_iter().map(described).collect()
}

/// Names of the outputs.
#[pyfunction]
pub(crate) fn outputs() -> Vec<&'static str> {
    OUTPUTS.iter().map(|output| output.name).collect()
}
