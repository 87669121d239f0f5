//! A layer as text (`.usda`).
//!
//! Must not know: what the prims mean.

use std::fmt::{self, Display, Write as _};

use glam::Vec3;

use super::layer::{Content, Field, Layer, Prim, Property, Value};

pub(super) fn encode(layer: &Layer) -> Vec<u8> {
    let mut out = String::with_capacity(64 << 20);
    out.push_str("#usda 1.0\n");
    // Writing into a string cannot fail.
    let _ = write_metadata(&mut out, "", &layer.metadata);
    for prim in &layer.prims {
        out.push('\n');
        let _ = write_prim(&mut out, "", prim);
    }
    out.into_bytes()
}

fn write_prim(out: &mut String, indent: &str, prim: &Prim) -> fmt::Result {
    write!(out, "{indent}def {} \"{}\"", prim.type_name, prim.name)?;
    if prim.metadata.is_empty() {
        out.push('\n');
    } else {
        out.push(' ');
        write_metadata(out, indent, &prim.metadata)?;
    }
    writeln!(out, "{indent}{{")?;
    let deeper = format!("{indent}    ");
    for property in &prim.properties {
        write_property(out, &deeper, property)?;
    }
    for (i, child) in prim.children.iter().enumerate() {
        if i > 0 || !prim.properties.is_empty() {
            out.push('\n');
        }
        write_prim(out, &deeper, child)?;
    }
    writeln!(out, "{indent}}}")
}

/// Metadata fields in parentheses, and a newline.
fn write_metadata(out: &mut String, indent: &str, fields: &[Field]) -> fmt::Result {
    if fields.is_empty() {
        return Ok(());
    }
    out.push_str("(\n");
    for (name, value) in fields {
        let deeper = format!("{indent}    ");
        match value {
            Value::PrependedTokens(_) => write!(out, "{deeper}prepend {name} = ")?,
            _ => write!(out, "{deeper}{name} = ")?,
        }
        write_value(out, &deeper, value)?;
        out.push('\n');
    }
    writeln!(out, "{indent})")
}

fn write_property(out: &mut String, indent: &str, property: &Property) -> fmt::Result {
    let Property { name, type_name, is_uniform, content, metadata } = property;
    let uniform = if *is_uniform { "uniform " } else { "" };
    match content {
        Content::Declared => write!(out, "{indent}{uniform}{type_name} {name}")?,
        Content::Connection(source) => {
            write!(out, "{indent}{uniform}{type_name} {name}.connect = <{source}>")?
        }
        Content::Target(target) => write!(out, "{indent}rel {name} = <{target}>")?,
        Content::Value(value) => {
            write!(out, "{indent}{uniform}{type_name} {name} = ")?;
            write_value(out, indent, value)?;
        }
    }
    if metadata.is_empty() {
        out.push('\n');
        return Ok(());
    }
    out.push(' ');
    write_metadata(out, indent, metadata)
}

fn write_value(out: &mut String, indent: &str, value: &Value) -> fmt::Result {
    match value {
        Value::Bool(value) => write!(out, "{}", u8::from(*value)),
        Value::Int(value) => write!(out, "{value}"),
        Value::Float(value) => write!(out, "{value}"),
        Value::Double(value) => write!(out, "{value}"),
        Value::String(text) | Value::Token(text) => write!(out, "{text:?}"),
        Value::Vec2f([x, y]) => write!(out, "({x}, {y})"),
        Value::Vec3f(v) => write!(out, "{}", Tuple(*v)),
        Value::Vec3d([x, y, z]) => write!(out, "({x}, {y}, {z})"),
        Value::Matrix4d(rows) => {
            let rows = rows.map(|[a, b, c, d]| format!("({a}, {b}, {c}, {d})"));
            write!(out, "( {} )", rows.join(", "))
        }
        Value::IntArray(values) => write_list(out, values),
        Value::Vec3fArray(values) => write_list(out, values.iter().map(|v| Tuple(*v))),
        Value::TokenArray(tokens) | Value::PrependedTokens(tokens) => {
            write_list(out, tokens.iter().map(|token| format!("{token:?}")))
        }
        Value::Dictionary(entries) => {
            out.push_str("{\n");
            for (key, value) in entries {
                write!(out, "{indent}    {} {key} = ", value.type_name())?;
                write_value(out, indent, value)?;
                out.push('\n');
            }
            write!(out, "{indent}}}")
        }
    }
}

fn write_list<T: Display>(out: &mut String, items: impl IntoIterator<Item = T>) -> fmt::Result {
    out.push('[');
    for (i, item) in items.into_iter().enumerate() {
        let comma = if i > 0 { ", " } else { "" };
        write!(out, "{comma}{item}")?;
    }
    out.push(']');
    Ok(())
}

/// A vector in the syntax of USD.
struct Tuple(Vec3);

impl Display for Tuple {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.0.to_array();
        write!(f, "({x}, {y}, {z})")
    }
}
