//! From the library's errors to Python's exceptions.

use pyo3::create_exception;
use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use regolith::Error;

create_exception!(
    regolith_render,
    ConfigError,
    PyValueError,
    "A setting that is wrong. Attributes, None where they do not apply: knob, value, allowed, nearest."
);
create_exception!(regolith_render, DeviceError, PyRuntimeError, "The graphics device or its driver failed.");
create_exception!(regolith_render, NoAdapterError, DeviceError, "There is no graphics adapter to use.");

pub(crate) fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("ConfigError", py.get_type::<ConfigError>())?;
    module.add("DeviceError", py.get_type::<DeviceError>())?;
    module.add("NoAdapterError", py.get_type::<NoAdapterError>())
}

/// What a [`ConfigError`] says of the setting: knob, value, what is allowed, the nearest known name.
type Details = [Option<String>; 4];

fn details(error: &Error) -> Details {
    let some = |text: &String| Some(text.clone());
    match error {
        Error::UnknownKnob { name, suggestion, .. } => [some(name), None, None, suggestion.clone()],
        Error::KnobOutOfRange { name, value, allowed, .. } => [some(name), some(value), some(allowed), None],
        Error::KnobType { name, value, expected, .. } => [some(name), some(value), some(expected), None],
        Error::UnknownPreset { name, suggestion, available } => {
            [None, some(name), Some(available.join(", ")), suggestion.clone()]
        }
        _ => [None, None, None, None],
    }
}

/// The exception for an error of the library.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let message = error.to_string();
    match error {
        Error::NoAdapter { .. } | Error::AdapterNotFound { .. } | Error::AdapterUnfit { .. } => {
            NoAdapterError::new_err(message)
        }
        Error::Read { .. } | Error::Write { .. } | Error::Config { .. } | Error::Thread(_) => {
            PyOSError::new_err(message)
        }
        _ if error.exit_status() == 2 || matches!(error, Error::RuleBroken { .. }) => {
            let exception = ConfigError::new_err(message);
            let value = exception.value(py);
            for (name, detail) in ["knob", "value", "allowed", "nearest"].into_iter().zip(details(error)) {
                if let Err(failure) = value.setattr(name, detail) {
                    return failure;
                }
            }
            exception
        }
        _ => DeviceError::new_err(message),
    }
}

/// A result with Python's exception.
pub(crate) fn raised<T>(py: Python<'_>, result: regolith::Result<T>) -> PyResult<T> {
    result.map_err(|error| exception(py, &error))
}
