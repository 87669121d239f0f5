//! The outputs of a frame as arrays in memory, with the values that its files hold.
//!
//! Must not know: file formats.

use super::encode::{EncodeInput, values};
use super::{LabelIds, Output};
use crate::frame::Frame;
use crate::frame::plane::{OwnedValues, Plane};
use crate::output::edges::{EdgePolicy, MaskIds};

/// An array over the pixels of a frame, rows from top to bottom.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Its name: that of its file in a dataset, without number and extension.
    pub name: &'static str,
    /// Values per pixel. The shape is (height, width), with more than one (height, width, channels).
    pub channels: usize,
    /// The values.
    pub values: OwnedValues,
}

/// Where the values of an array come from.
enum Source {
    /// A plane of the frame, as it is.
    Plane(Plane),
    /// The semantic mask.
    Mask,
    /// Computed from planes, with this many values per pixel.
    Computed(usize, fn(&EncodeInput<'_>) -> OwnedValues),
}

/// What an output's file of this stem holds, and the name of the array; `None` for a file of text.
fn source(stem: &'static str) -> Option<(&'static str, Source)> {
    use OwnedValues::{F32, U8};
    use Source::{Computed, Mask, Plane as Of};
    let source = match stem {
        "rgb" => Of(Plane::Rgb),
        "semantic_segmentation" => return Some(("mask", Mask)),
        "preview" => Computed(3, |input| U8(values::preview(input))),
        "distance_to_image_plane" => Of(Plane::Depth),
        "distance_to_camera" => Computed(1, |input| F32(values::camera_distance(input.frame))),
        "normals" => Of(Plane::Normals),
        "instance_segmentation" => Of(Plane::Instances),
        "shadow" => Of(Plane::SunOcclusion),
        "hdr" => Of(Plane::Radiance),
        "semantic_coverage" => Computed(3, |input| F32(values::coverage(input.frame))),
        "slope" => Of(Plane::Slope),
        "craters" => Of(Plane::Craters),
        "incidence" => Of(Plane::Incidence),
        "phase" => Of(Plane::Phase),
        "five_classes" => Computed(1, |input| U8(values::five_classes(input))),
        "five_classes_preview" => Computed(3, |input| U8(values::five_classes_preview(input))),
        "rock_sizes" => Computed(3, |input| U8(values::rock_sizes(input))),
        _ => return None,
    };
    Some((stem, source))
}

/// The arrays of these outputs, in their order. Planes of the frame are moved out of it, not copied.
#[must_use]
pub fn arrays(mut frame: Frame, outputs: &[&'static Output], mask: &MaskIds) -> Vec<Array> {
    let stems = outputs.iter().flat_map(|output| output.file_kinds().map(|kind| kind.stem));
    let sources: Vec<_> = stems.filter_map(source).collect();
    let input =
        EncodeInput { frame: &frame, meta: &serde_json::Value::Null, label_ids: LabelIds::Canonical, mask };
    // Planes are moved last, as others are computed from them.
    let mut computed: Vec<Option<OwnedValues>> = sources
        .iter()
        .map(|(_, source)| match source {
            Source::Computed(_, values) => Some(values(&input)),
            Source::Mask if mask.edges() != EdgePolicy::Hard => Some(OwnedValues::U8(values::mask(&input))),
            Source::Mask | Source::Plane(_) => None,
        })
        .collect();
    let moved = |(number, (name, source)): (usize, &(&'static str, Source))| {
        let (channels, plane) = match source {
            Source::Plane(plane) => (plane.row().channels, *plane),
            Source::Mask => (1, Plane::Class),
            Source::Computed(channels, _) => (*channels, Plane::Class),
        };
        let values = computed[number].take().unwrap_or_else(|| frame.take_plane(plane));
        Array { name, channels, values }
    };
    sources.iter().enumerate().map(moved).collect()
}

/// Name, values per pixel and NumPy type of the arrays of these outputs, in the order of [`arrays`].
#[must_use]
pub fn described(outputs: &[&'static Output]) -> Vec<(&'static str, usize, &'static str)> {
    let one_pixel = Frame { width: 1, height: 1, ..Frame::default() };
    let type_of = |values: &OwnedValues| match values {
        OwnedValues::U8(_) => "uint8",
        OwnedValues::U16(_) => "uint16",
        OwnedValues::F16(_) => "float16",
        OwnedValues::F32(_) => "float32",
    };
    let arrays = arrays(one_pixel, outputs, &MaskIds::default());
    arrays.iter().map(|array| (array.name, array.channels, type_of(&array.values))).collect()
}
