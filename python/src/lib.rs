//! The native module of the Python package `regolith_render`: a thin binding of the library. What a user meets is in
//! `python/regolith_render`.

mod convert;
mod ending;
mod engine;
mod errors;
mod scene;
mod tables;

use std::ffi::OsString;
use std::process::Command;

use pyo3::prelude::*;

/// The program of a process that a command starts. `-m` would put the current folder first in `sys.path`, and `-c` puts an empty text
/// there that means it: a file of that folder with the name of a module would be imported instead of the module.
const COMMAND_LINE: &str = "import sys; sys.path[:] = [folder for folder in sys.path if folder]; \
                            from regolith_render.__main__ import main; sys.exit(main())";

/// Runs the command line; the first word is the name of the program. Returns the exit status.
#[pyfunction]
fn main(py: Python<'_>, words: Vec<OsString>, executable: OsString) -> u8 {
    let itself = || {
        let mut command = Command::new(&executable);
        command.args(["-c", COMMAND_LINE]);
        command
    };
    py.detach(|| regolith::cli::main(words, &itself))
}

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    // The first array of a process loads NumPy's C interface, and panics if a signal is pending: Ctrl-C during the first frame.
    drop(numpy::PyArray1::<u8>::from_vec(module.py(), Vec::new()));
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    errors::add_to(module)?;
    ending::register(module)?;
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
