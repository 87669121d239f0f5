//! What can be requested of a frame besides colour and class.

/// What a frame can have besides colour and class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Annotation {
    /// Depth along the optical axis.
    Depth,
    /// World normals.
    Normals,
    /// Instance ids, and a label for each visible rock.
    Instances,
    /// Occlusion of the sun.
    Shadow,
    /// Linear radiance.
    Hdr,
    /// Fraction of each class within a pixel.
    Coverage,
    /// Slope of the ground.
    Slope,
    /// Insides and rims of craters.
    Craters,
    /// Angles of incidence and phase.
    Angles,
    /// Classes with craters and far ground distinguished.
    FiveClasses,
}

/// A set of [`Annotation`]s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Annotations(u16);

impl Annotations {
    /// The set with one more.
    #[must_use]
    pub const fn with(self, annotation: Annotation) -> Self {
        Self(self.0 | 1 << annotation as u8)
    }

    /// Whether it is in the set.
    #[must_use]
    pub const fn contains(self, annotation: Annotation) -> bool {
        self.0 & 1 << annotation as u8 != 0
    }
}

impl FromIterator<Annotation> for Annotations {
    fn from_iter<T: IntoIterator<Item = Annotation>>(annotations: T) -> Self {
        annotations.into_iter().fold(Self::default(), Self::with)
    }
}
