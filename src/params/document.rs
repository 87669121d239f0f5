//! The entries of a TOML document, in the order of the text.
//!
//! Must not know: what a knob does.

use super::knobs::KNOBS;

/// Collects the entries of a document under their dotted names, each with its byte offset in the text: the table itself
/// is sorted by name, and the first error reported should be the first one in the text.
pub(super) fn collect_entries<'a>(
    prefix: &str,
    table: &'a toml::Table,
    spans: &toml::de::DeTable<'_>,
    entries: &mut Vec<(usize, String, &'a toml::Value)>,
) {
    for (key, span) in spans {
        let name =
            if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
        match (&table[key.get_ref().as_ref()], span.get_ref()) {
            (toml::Value::Table(inner), toml::de::DeValue::Table(spans)) if is_section(&name) => {
                collect_entries(&name, inner, spans, entries);
            }
            (value, _) => entries.push((key.span().start, name, value)),
        }
    }
}

/// Whether a value contains NaN or an infinity.
pub(super) fn has_non_finite(value: &toml::Value) -> bool {
    match value {
        toml::Value::Float(number) => !number.is_finite(),
        toml::Value::Array(list) => list.iter().any(has_non_finite),
        toml::Value::Table(table) => table.iter().any(|(_, inner)| has_non_finite(inner)),
        _ => false,
    }
}

fn is_section(name: &str) -> bool {
    let name = name.strip_prefix("fallback.").unwrap_or(name);
    matches!(name, "rules" | "fallback") || KNOBS.iter().any(|info| info.name.split('.').next() == Some(name))
}
