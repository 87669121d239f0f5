//! From frames to NumPy arrays, without copying, and from records to JSON text.

use numpy::{Element, PyArray1, PyArrayMethods as _};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use regolith::dataset::FrameInMemory;
use regolith::frame::plane::OwnedValues;
use regolith::output::arrays::Array;

/// A frame for Python: arrays by name, the record as JSON, the mapping of instances as JSON.
pub(crate) type PyFrame<'py> = (Bound<'py, PyDict>, String, String);

/// The arrays of a frame own the memory that was rendered into.
pub(crate) fn frame<'py>(py: Python<'py>, frame: FrameInMemory) -> PyResult<PyFrame<'py>> {
    let FrameInMemory { size, arrays, record, rocks, .. } = frame;
    let named = PyDict::new(py);
    for Array { name, channels, values } in arrays {
        named.set_item(name, shaped(py, values, size, channels)?)?;
    }
    let text = |map| serde_json::Value::Object(map).to_string();
    Ok((named, text(record), text(rocks)))
}

fn shaped(
    py: Python<'_>,
    values: OwnedValues,
    [width, height]: [u32; 2],
    channels: usize,
) -> PyResult<Bound<'_, PyAny>> {
    let size = [height as usize, width as usize];
    match values {
        OwnedValues::U8(values) => array(py, values, size, channels),
        OwnedValues::U16(values) => array(py, values, size, channels),
        OwnedValues::F16(values) => array(py, values, size, channels),
        OwnedValues::F32(values) => array(py, values, size, channels),
    }
}

fn array<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    [height, width]: [usize; 2],
    channels: usize,
) -> PyResult<Bound<'_, PyAny>> {
    let flat = PyArray1::from_vec(py, values);
    Ok(if channels == 1 {
        flat.reshape([height, width])?.into_any()
    } else {
        flat.reshape([height, width, channels])?.into_any()
    })
}
