//! The planes of a frame: a row of [`PLANES`] each, with the name, data type and shape that NumPy sees.
//!
//! To add a plane: a variant of [`Plane`], a row in [`PLANES`], a field of [`Frame`](super::Frame). The compiler then asks for
//! its arms: in `Frame::plane`, in `resolve_rule` (`render/device/planes.rs`), and in `unpack_plane`
//! (`render/resolve/unpack.rs`).
//! Must not know: how a plane is rendered or encoded.

use super::annotation::{Annotation, Annotations};

/// An array over the pixels of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plane {
    /// 8-bit sRGB.
    Rgb,
    /// Class id.
    Class,
    /// Metres along the optical axis.
    Depth,
    /// World normal.
    Normals,
    /// Instance id.
    Instances,
    /// Fraction of the sun's disc that is occluded, 0 to 255.
    SunOcclusion,
    /// Linear radiance.
    Radiance,
    /// Samples of each class.
    SampleCounts,
    /// Slope of the ground, degrees.
    Slope,
    /// Inside and rim of craters.
    Craters,
    /// Angle between normal and sun, degrees.
    Incidence,
    /// Angle between sun and eye, degrees.
    Phase,
    /// Class id, with classes for craters and far ground.
    FiveClasses,
}

/// Type of a value of a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DType {
    /// `uint8`
    U8,
    /// `uint16`
    U16,
    /// `float16`
    F16,
    /// `float32`
    F32,
}

impl DType {
    /// Bytes of a value.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::F16 => 2,
            Self::F32 => 4,
        }
    }

    /// Its name in NumPy.
    #[must_use]
    pub const fn numpy(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::F16 => "float16",
            Self::F32 => "float32",
        }
    }
}

/// A row of [`PLANES`].
#[derive(Clone, Copy, Debug)]
pub struct PlaneRow {
    /// The plane.
    pub plane: Plane,
    /// Name of the array: the field of [`Frame`](super::Frame).
    pub name: &'static str,
    /// Type of its values.
    pub dtype: DType,
    /// Values per pixel. The array's shape is (height, width), with more than one (height, width, channels).
    pub channels: usize,
    /// The annotation that it is part of, `None` for what every frame has.
    pub annotation: Option<Annotation>,
}

const fn row(
    plane: Plane,
    name: &'static str,
    dtype: DType,
    channels: usize,
    annotation: Option<Annotation>,
) -> PlaneRow {
    PlaneRow { plane, name, dtype, channels, annotation }
}

/// Every plane, in the order of [`Plane`].
pub static PLANES: [PlaneRow; 13] = [
    row(Plane::Rgb, "rgb", DType::U8, 3, None),
    row(Plane::Class, "class", DType::U8, 1, None),
    row(Plane::Depth, "depth_m", DType::F32, 1, Some(Annotation::Depth)),
    row(Plane::Normals, "normals", DType::F32, 3, Some(Annotation::Normals)),
    row(Plane::Instances, "instances", DType::U16, 1, Some(Annotation::Instances)),
    row(Plane::SunOcclusion, "sun_occlusion", DType::U8, 1, Some(Annotation::Shadow)),
    row(Plane::Radiance, "radiance", DType::F16, 3, Some(Annotation::Hdr)),
    row(Plane::SampleCounts, "sample_counts", DType::U8, 3, Some(Annotation::Coverage)),
    row(Plane::Slope, "slope_deg", DType::F32, 1, Some(Annotation::Slope)),
    row(Plane::Craters, "craters", DType::U8, 1, Some(Annotation::Craters)),
    row(Plane::Incidence, "incidence_deg", DType::F32, 1, Some(Annotation::Angles)),
    row(Plane::Phase, "phase_deg", DType::F32, 1, Some(Annotation::Angles)),
    row(Plane::FiveClasses, "five_classes", DType::U8, 1, Some(Annotation::FiveClasses)),
];

/// The annotations of every plane.
#[must_use]
pub fn every_annotation() -> Annotations {
    PLANES.iter().filter_map(|row| row.annotation).collect()
}

impl Plane {
    /// Its row.
    #[must_use]
    pub fn row(self) -> &'static PlaneRow {
        &PLANES[self as usize]
    }

    /// Whether a frame with these annotations has it.
    #[must_use]
    pub fn is_in(self, annotations: Annotations) -> bool {
        self.row().annotation.is_none_or(|annotation| annotations.contains(annotation))
    }
}

/// The values of a plane, rows of pixels from top to bottom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Values<'a> {
    /// Of [`DType::U8`].
    U8(&'a [u8]),
    /// Of [`DType::U16`].
    U16(&'a [u16]),
    /// Of [`DType::F16`].
    F16(&'a [half::f16]),
    /// Of [`DType::F32`].
    F32(&'a [f32]),
}

/// The values of a plane on their own.
#[derive(Clone, Debug, PartialEq)]
pub enum OwnedValues {
    /// Of [`DType::U8`].
    U8(Vec<u8>),
    /// Of [`DType::U16`].
    U16(Vec<u16>),
    /// Of [`DType::F16`].
    F16(Vec<half::f16>),
    /// Of [`DType::F32`].
    F32(Vec<f32>),
}

impl Values<'_> {
    /// Their type.
    #[must_use]
    pub const fn dtype(self) -> DType {
        match self {
            Self::U8(_) => DType::U8,
            Self::U16(_) => DType::U16,
            Self::F16(_) => DType::F16,
            Self::F32(_) => DType::F32,
        }
    }

    /// How many there are: none if the plane was not requested.
    #[must_use]
    pub const fn len(self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
            Self::F16(values) => values.len(),
            Self::F32(values) => values.len(),
        }
    }

    /// Whether the plane was not requested.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }
}
