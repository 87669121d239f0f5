//! NumPy array files (`.npy`, format version 1.0).

use super::{EncodeInput, values};
use crate::error::Result;
use crate::frame::Frame;

/// Distance along the optical axis, metres; infinite for the sky.
pub(in crate::output) fn plane_distance(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    Ok(array(input.frame, 1, &input.frame.depth_m))
}

/// Length of the ray from the camera, metres; infinite for the sky.
pub(in crate::output) fn camera_distance(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    Ok(array(input.frame, 1, &values::camera_distance(input.frame)))
}

/// Unit normals in world space.
pub(in crate::output) fn normals(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    Ok(array(input.frame, 3, &input.frame.normals))
}

/// Fraction of a pixel's samples that belong to each class, by class id.
pub(in crate::output) fn coverage(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    Ok(array(input.frame, 3, &values::coverage(input.frame)))
}

/// Slope of the ground, degrees.
pub(in crate::output) fn slope(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    Ok(array(input.frame, 1, &input.frame.slope_deg))
}

/// Incidence angle, degrees.
pub(in crate::output) fn incidence(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    Ok(array(input.frame, 1, &input.frame.incidence_deg))
}

/// Phase angle, degrees.
pub(in crate::output) fn phase(input: &EncodeInput<'_>) -> Result<Vec<u8>> {
    Ok(array(input.frame, 1, &input.frame.phase_deg))
}

/// An array of float32: rows x columns, or rows x columns x `channels`.
fn array(frame: &Frame, channels: usize, values: &[f32]) -> Vec<u8> {
    let shape = [frame.height as usize, frame.width as usize, channels];
    let mut bytes = header("<f4", if channels == 1 { &shape[..2] } else { &shape });
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// The header of an array file for a type (`<f4`, `|u1`, ...) and shape; the data follow in C order.
#[must_use]
pub(crate) fn header(dtype: &str, shape: &[usize]) -> Vec<u8> {
    let shape: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let shape = shape.join(", ");
    let mut header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({shape}{comma}), }}");
    // Magic, version and length take ten bytes; the data start at a multiple of 64.
    header.push_str(&" ".repeat(63 - (header.len() + 10) % 64));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes
}
