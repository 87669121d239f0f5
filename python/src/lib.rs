//! The native module of the Python package `regolith_render`: a thin binding of the library. What a user meets is in
//! `python/regolith_render`.

mod convert;
mod engine;
mod errors;
mod scene;
mod tables;

use std::ffi::OsString;
use std::process::Command;

use pyo3::prelude::*;

/// Runs the command line; the first word is the name of the program. Returns the exit status.
#[pyfunction]
fn main(py: Python<'_>, words: Vec<OsString>, executable: OsString) -> u8 {
    let itself = || {
        let mut command = Command::new(&executable);
        command.args(["-m", "regolith_render"]);
        command
    };
    py.detach(|| regolith::cli::main(words, &itself))
}

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    errors::add_to(module)?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    module.add_function(wrap_pyfunction!(engine::config_text, module)?)?;
    module.add_function(wrap_pyfunction!(tables::adapters, module)?)?;
    module.add_function(wrap_pyfunction!(tables::knobs, module)?)?;
    module.add_function(wrap_pyfunction!(tables::presets, module)?)?;
    module.add_function(wrap_pyfunction!(tables::outputs, module)?)?;
    module.add_class::<engine::Settings>()?;
    module.add_class::<engine::Engine>()?;
    module.add_class::<engine::Frames>()?;
    module.add_class::<scene::Scene>()
}
