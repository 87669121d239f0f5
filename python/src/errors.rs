//! From the library's errors to Python's exceptions.

use pyo3::create_exception;
use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use regolith::Error;
use regolith::dataset::rules::Rules;

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
    let config_error = py.get_type::<ConfigError>();
    for name in DETAILS {
        config_error.setattr(name, py.None())?;
    }
    module.add("ConfigError", config_error)?;
    module.add("DeviceError", py.get_type::<DeviceError>())?;
    module.add("NoAdapterError", py.get_type::<NoAdapterError>())
}

/// Names of the attributes of a [`ConfigError`].
const DETAILS: [&str; 4] = ["knob", "value", "allowed", "nearest"];

/// What a [`ConfigError`] says of the setting, in the order of [`DETAILS`].
type Details = [Option<String>; 4];

fn details(error: &Error) -> Details {
    let some = |text: &String| Some(text.clone());
    match error {
        Error::UnknownKnob { name, suggestion, .. } => [some(name), None, None, suggestion.clone()],
        Error::KnobOutOfRange { name, value, allowed, suggestion, .. } => {
            [some(name), some(value), some(allowed), suggestion.clone()]
        }
        Error::KnobType { name, value, expected, .. } => [some(name), some(value), some(expected), None],
        Error::UnknownPreset { name, suggestion, available }
        | Error::UnknownOutput { name, suggestion, available, .. } => {
            [None, some(name), Some(available.join(", ")), suggestion.clone()]
        }
        Error::RuleBroken { rule, value, .. } => [Rules::setting_of(rule), value.clone(), None, None],
        _ => [None, None, None, None],
    }
}

/// What to do about an error, in words of the package; the command line has [`Error::advice`].
fn advice(error: &Error) -> &'static str {
    match error {
        Error::OutOfMemory => "; use a smaller size or fewer samples",
        Error::DeviceLost(_) => {
            "; call `close()` of the renderer, whose next use opens the device again; if it is lost again, use a smaller size or another \
             adapter"
        }
        Error::Unlabelled { .. } => {
            "; render the frame again; if it happens again, use raster=\"host\" or another adapter, and please report the settings: it is \
             a bug in the driver or in regolith-render"
        }
        Error::RuleBroken { .. } => "; loosen the rule or change the knobs",
        _ => "",
    }
}

/// The exception for a value of an argument that is none of those allowed.
pub(crate) fn refused(
    py: Python<'_>,
    argument: &str,
    value: &str,
    allowed: &str,
    nearest: Option<String>,
) -> PyErr {
    let suggestion =
        nearest.as_ref().map_or_else(String::new, |nearest| format!(" (did you mean `{nearest}`?)"));
    let message = format!("{argument} = {value}: allowed are {allowed}{suggestion}");
    config_error(py, message, [None, Some(value.to_owned()), Some(allowed.to_owned()), nearest])
}

fn config_error(py: Python<'_>, message: String, details: Details) -> PyErr {
    let exception = ConfigError::new_err(message);
    let value = exception.value(py);
    for (name, detail) in DETAILS.into_iter().zip(details) {
        if let Err(failure) = value.setattr(name, detail) {
            return failure;
        }
    }
    exception
}

/// The exception for an error of the library.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let message = format!("{error}{}", advice(error));
    match error {
        Error::NoAdapter { .. } | Error::AdapterNotFound { .. } | Error::AdapterUnfit { .. } => {
            NoAdapterError::new_err(message)
        }
        Error::Config { cause, .. } if cause.kind() == std::io::ErrorKind::InvalidData => {
            ConfigError::new_err(message)
        }
        Error::Read { cause, .. } | Error::Write { cause, .. } | Error::Config { cause, .. } => {
            // The class is that of the cause: FileNotFoundError, PermissionError, ...
            std::io::Error::new(cause.kind(), message).into()
        }
        Error::Thread(_) => PyOSError::new_err(message),
        Error::RuleBroken { .. } => config_error(py, message, details(error)),
        _ if error.exit_status() == 2 => {
            // What is an option of the command line is an argument here.
            let message = message.trim_start_matches("--").replace(" --", " ");
            config_error(py, message, details(error))
        }
        _ => DeviceError::new_err(message),
    }
}

/// A result with Python's exception.
pub(crate) fn raised<T>(py: Python<'_>, result: regolith::Result<T>) -> PyResult<T> {
    result.map_err(|error| exception(py, &error))
}
