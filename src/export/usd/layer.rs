//! A layer of OpenUSD as plain data: prims with typed properties.
//!
//! Covers the part of Sdf's data model that the exported stage needs: prims, attributes, relationships and metadata; no
//! variants, time samples or composition arcs.
//! Must not know: file formats.
//! To add a type of value: a variant of [`Value`], its syntax in `text`, its type number and encoding in `crate_file`.

use glam::Vec3;

/// Name and value of a metadata field.
pub(super) type Field = (&'static str, Value);

/// A layer: the content of one file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layer {
    pub metadata: Vec<Field>,
    pub prims: Vec<Prim>,
}

/// A prim with specifier `def`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Prim {
    pub name: String,
    pub type_name: &'static str,
    pub metadata: Vec<Field>,
    pub properties: Vec<Property>,
    pub children: Vec<Self>,
}

/// An attribute or a relationship.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Property {
    pub name: &'static str,
    /// Empty for a relationship.
    pub type_name: &'static str,
    pub is_uniform: bool,
    pub content: Content,
    pub metadata: Vec<Field>,
}

/// The content of a property.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Content {
    /// None: the property is only declared.
    Declared,
    /// The default value of an attribute.
    Value(Value),
    /// Path of the source attribute of a connection.
    Connection(String),
    /// Path of the target of a relationship.
    Target(String),
}

/// A value of an attribute or of metadata.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Bool(bool),
    Int(i32),
    Float(f32),
    Double(f64),
    String(String),
    Token(String),
    Vec2f([f32; 2]),
    Vec3f(Vec3),
    Vec3d([f64; 3]),
    Matrix4d([[f64; 4]; 4]),
    IntArray(Vec<i32>),
    Vec3fArray(Vec<Vec3>),
    TokenArray(Vec<String>),
    /// A list operation that prepends tokens to those of weaker layers.
    PrependedTokens(Vec<String>),
    Dictionary(Vec<Field>),
}

impl Prim {
    pub(super) fn new(name: &str, type_name: &'static str) -> Self {
        let (metadata, properties, children) = (Vec::new(), Vec::new(), Vec::new());
        Self { name: name.to_owned(), type_name, metadata, properties, children }
    }
}

impl Property {
    fn with_content(name: &'static str, type_name: &'static str, content: Content) -> Self {
        Self { name, type_name, is_uniform: false, content, metadata: Vec::new() }
    }

    pub(super) fn new(name: &'static str, type_name: &'static str, value: Value) -> Self {
        Self::with_content(name, type_name, Content::Value(value))
    }

    pub(super) fn declared(name: &'static str, type_name: &'static str) -> Self {
        Self::with_content(name, type_name, Content::Declared)
    }

    pub(super) fn connected(name: &'static str, type_name: &'static str, source: String) -> Self {
        Self::with_content(name, type_name, Content::Connection(source))
    }

    pub(super) fn relationship(name: &'static str, target: String) -> Self {
        Self::with_content(name, "", Content::Target(target))
    }

    pub(super) fn uniform(mut self) -> Self {
        self.is_uniform = true;
        self
    }

    pub(super) fn with(mut self, field: &'static str, value: Value) -> Self {
        self.metadata.push((field, value));
        self
    }
}

impl Value {
    /// Name of its type in the text format.
    pub(super) const fn type_name(&self) -> &'static str {
        match self {
            Self::Bool(_) => "bool",
            Self::Int(_) => "int",
            Self::Float(_) => "float",
            Self::Double(_) => "double",
            Self::String(_) => "string",
            Self::Token(_) => "token",
            Self::Vec2f(_) => "float2",
            Self::Vec3f(_) => "float3",
            Self::Vec3d(_) => "double3",
            Self::Matrix4d(_) => "matrix4d",
            Self::IntArray(_) => "int[]",
            Self::Vec3fArray(_) => "float3[]",
            Self::TokenArray(_) | Self::PrependedTokens(_) => "token[]",
            Self::Dictionary(_) => "dictionary",
        }
    }
}
