//! A layer as a crate file (`.usdc`), the binary format of OpenUSD, version 0.8.0.
//!
//! A crate file has a bootstrap header, values, and six sections that refer to each other by index: tokens, strings,
//! fields (name and value representation), field sets (lists of fields, each terminated by -1), paths (a tree in
//! depth-first order) and specs (path, field set, spec type). A value representation holds the type and either the
//! value itself, if it fits into 48 bits (inlined), or its offset in the file. Source: OpenUSD, `pxr/usd/sdf/crateFile.h`,
//! `crateFile.cpp` and `integerCoding.cpp`.
//! Must not know: what the prims mean.

use std::collections::BTreeMap;

use super::layer::{Content, Field, Layer, Prim, Property, Value};

const MAGIC: &[u8; 8] = b"PXR-USDC";
const VERSION: [u8; 8] = [0, 8, 0, 0, 0, 0, 0, 0];
const BOOTSTRAP_BYTES: usize = 88;

// Type numbers (`crateDataTypes.h`).
const BOOL: u64 = 1;
const INT: u64 = 3;
const FLOAT: u64 = 8;
const DOUBLE: u64 = 9;
const STRING: u64 = 10;
const TOKEN: u64 = 11;
const MATRIX_4D: u64 = 15;
const VEC_2F: u64 = 20;
const VEC_3D: u64 = 23;
const VEC_3F: u64 = 24;
const DICTIONARY: u64 = 31;
const TOKEN_LIST_OP: u64 = 32;
const PATH_LIST_OP: u64 = 34;
const TOKEN_VECTOR: u64 = 41;
const SPECIFIER: u64 = 42;
const VARIABILITY: u64 = 44;

const IS_ARRAY: u64 = 1 << 63;
const IS_INLINED: u64 = 1 << 62;
// Bits of the first byte of a list operation (`ListOpHeader`).
const EXPLICIT_ITEMS: u8 = 0b11;
const PREPENDED_ITEMS: u8 = 1 << 5;

// Spec types (`SdfSpecType`).
const ATTRIBUTE: u32 = 1;
const PRIM: u32 = 6;
const PSEUDO_ROOT: u32 = 7;
const RELATIONSHIP: u32 = 8;

/// Terminates a field set.
const FIELD_SET_END: u32 = u32::MAX;

pub(super) fn encode(layer: &Layer) -> Vec<u8> {
    let mut writer = CrateWriter::default();
    writer.bytes.resize(BOOTSTRAP_BYTES, 0);
    let root = writer.index_paths(layer);
    writer.root_spec(layer, &root);
    writer.finish(&root)
}

/// A path in the tree of paths.
struct PathNode {
    /// Index of the path.
    index: u32,
    /// Token of its last element, negated for a property.
    element: i32,
    children: Vec<Self>,
}

/// The tables of a crate file as they grow. Equal tokens, fields and field sets are stored once.
#[derive(Default)]
struct CrateWriter {
    /// The file so far: bootstrap header and values.
    bytes: Vec<u8>,
    tokens: Vec<String>,
    token_indices: BTreeMap<String, u32>,
    /// Token of each string.
    strings: Vec<u32>,
    path_indices: BTreeMap<String, u32>,
    /// Name token and value representation of each field.
    fields: Vec<(u32, u64)>,
    field_indices: BTreeMap<(u32, u64), u32>,
    field_sets: Vec<u32>,
    field_set_indices: BTreeMap<Vec<u32>, u32>,
    /// Path, field set and spec type of each spec.
    specs: Vec<[u32; 3]>,
}

impl CrateWriter {
    fn token(&mut self, text: &str) -> u32 {
        if let Some(number) = self.token_indices.get(text) {
            return *number;
        }
        let number = self.tokens.len() as u32;
        self.tokens.push(text.to_owned());
        self.token_indices.insert(text.to_owned(), number);
        number
    }

    fn string(&mut self, text: &str) -> u32 {
        let token = self.token(text);
        self.strings.push(token);
        self.strings.len() as u32 - 1
    }

    /// Indexes every path of a layer in depth-first order, before any value refers to one.
    fn index_paths(&mut self, layer: &Layer) -> PathNode {
        // The root takes token 0, which cannot be negated to mark a property.
        let element = self.token("") as i32;
        let index = self.path("/");
        let children = layer.prims.iter().map(|prim| self.index_prim("", prim)).collect();
        PathNode { index, element, children }
    }

    fn path(&mut self, path: &str) -> u32 {
        let next = self.path_indices.len() as u32;
        *self.path_indices.entry(path.to_owned()).or_insert(next)
    }

    fn index_prim(&mut self, parent: &str, prim: &Prim) -> PathNode {
        let path = format!("{parent}/{}", prim.name);
        let (index, element) = (self.path(&path), self.token(&prim.name) as i32);
        let mut children = Vec::with_capacity(prim.properties.len() + prim.children.len());
        for property in &prim.properties {
            let index = self.path(&format!("{path}.{}", property.name));
            let element = -(self.token(property.name) as i32);
            children.push(PathNode { index, element, children: Vec::new() });
        }
        for child in &prim.children {
            children.push(self.index_prim(&path, child));
        }
        PathNode { index, element, children }
    }

    fn root_spec(&mut self, layer: &Layer, root: &PathNode) {
        let mut fields = self.metadata(&layer.metadata);
        fields.extend(self.names("primChildren", layer.prims.iter().map(|prim| prim.name.as_str())));
        self.spec(root.index, &fields, PSEUDO_ROOT);
        for prim in &layer.prims {
            self.prim_spec("", prim);
        }
    }

    fn prim_spec(&mut self, parent: &str, prim: &Prim) {
        let path = format!("{parent}/{}", prim.name);
        // The specifier `def` is 0.
        let mut fields = vec![self.field("specifier", inlined(SPECIFIER, 0))];
        let type_name = self.token(prim.type_name);
        fields.push(self.field("typeName", inlined(TOKEN, type_name)));
        fields.extend(self.metadata(&prim.metadata));
        fields.extend(self.names("properties", prim.properties.iter().map(|property| property.name)));
        fields.extend(self.names("primChildren", prim.children.iter().map(|child| child.name.as_str())));
        let index = self.path(&path);
        self.spec(index, &fields, PRIM);
        for property in &prim.properties {
            self.property_spec(&path, property);
        }
        for child in &prim.children {
            self.prim_spec(&path, child);
        }
    }

    fn property_spec(&mut self, prim: &str, property: &Property) {
        let mut fields = vec![self.field("custom", inlined(BOOL, 0))];
        let is_relationship = matches!(property.content, Content::Target(_));
        if !is_relationship {
            let type_name = self.token(property.type_name);
            fields.push(self.field("typeName", inlined(TOKEN, type_name)));
        }
        // Relationships are always uniform.
        let variability = u32::from(property.is_uniform || is_relationship);
        fields.push(self.field("variability", inlined(VARIABILITY, variability)));
        match &property.content {
            Content::Declared => {}
            Content::Value(value) => {
                let value = self.value(value);
                fields.push(self.field("default", value));
            }
            Content::Connection(path) => {
                let paths = self.path_list(path);
                fields.push(self.field("connectionPaths", paths));
            }
            Content::Target(path) => {
                let paths = self.path_list(path);
                fields.push(self.field("targetPaths", paths));
            }
        }
        fields.extend(self.metadata(&property.metadata));
        let index = self.path(&format!("{prim}.{}", property.name));
        self.spec(index, &fields, if is_relationship { RELATIONSHIP } else { ATTRIBUTE });
    }

    fn metadata(&mut self, fields: &[Field]) -> Vec<u32> {
        let mut indices = Vec::new();
        for (name, value) in fields {
            let value = self.value(value);
            indices.push(self.field(name, value));
        }
        indices
    }

    /// A field with a list of names; `None` if the list is empty.
    fn names<'a>(&mut self, field: &str, names: impl Iterator<Item = &'a str>) -> Option<u32> {
        let tokens: Vec<u32> = names.map(|name| self.token(name)).collect();
        (!tokens.is_empty()).then(|| {
            let value = self.start(TOKEN_VECTOR);
            self.put_list(&tokens);
            self.field(field, value)
        })
    }

    fn field(&mut self, name: &str, value: u64) -> u32 {
        let key = (self.token(name), value);
        let next = self.fields.len() as u32;
        let index = *self.field_indices.entry(key).or_insert(next);
        if index == next {
            self.fields.push(key);
        }
        index
    }

    fn spec(&mut self, path: u32, fields: &[u32], spec_type: u32) {
        let next = self.field_sets.len() as u32;
        let set = *self.field_set_indices.entry(fields.to_vec()).or_insert(next);
        if set == next {
            self.field_sets.extend(fields);
            self.field_sets.push(FIELD_SET_END);
        }
        self.specs.push([path, set, spec_type]);
    }

    /// Representation of a value of this type that is written next.
    fn start(&self, type_number: u64) -> u64 {
        type_number << 48 | self.bytes.len() as u64
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        self.bytes.extend(bytes);
    }

    fn put_list(&mut self, indices: &[u32]) {
        self.put((indices.len() as u64).to_le_bytes());
        indices.iter().for_each(|index| self.bytes.extend(index.to_le_bytes()));
    }

    fn path_list(&mut self, path: &str) -> u64 {
        let index = self.path(path);
        let value = self.start(PATH_LIST_OP);
        self.put([EXPLICIT_ITEMS]);
        self.put_list(&[index]);
        value
    }

    /// The representation of a value, which is written to the file unless it is inlined.
    fn value(&mut self, value: &Value) -> u64 {
        match value {
            Value::Bool(value) => inlined(BOOL, u32::from(*value)),
            Value::Int(value) => inlined(INT, value.cast_unsigned()),
            Value::Float(value) => inlined(FLOAT, value.to_bits()),
            Value::Token(text) => inlined(TOKEN, self.token(text)),
            Value::String(text) => inlined(STRING, self.string(text)),
            Value::Double(value) => self.plain(DOUBLE, &[*value]),
            Value::Vec2f(value) => self.plain(VEC_2F, value),
            Value::Vec3f(value) => self.plain(VEC_3F, &value.to_array()),
            Value::Vec3d(value) => self.plain(VEC_3D, value),
            Value::Matrix4d(rows) => self.plain(MATRIX_4D, rows.as_flattened()),
            Value::IntArray(values) => self.array(INT, values.len(), values),
            Value::Vec3fArray(values) => {
                self.array(VEC_3F, values.len(), bytemuck::cast_slice::<_, f32>(values))
            }
            Value::TokenArray(texts) => {
                let tokens: Vec<u32> = texts.iter().map(|text| self.token(text)).collect();
                self.array(TOKEN, tokens.len(), &tokens)
            }
            Value::PrependedTokens(texts) => {
                let tokens: Vec<u32> = texts.iter().map(|text| self.token(text)).collect();
                let value = self.start(TOKEN_LIST_OP);
                self.put([PREPENDED_ITEMS]);
                self.put_list(&tokens);
                value
            }
            Value::Dictionary(entries) => {
                let value = self.start(DICTIONARY);
                self.put((entries.len() as u64).to_le_bytes());
                for (key, entry) in entries {
                    let key = self.string(key);
                    self.put(key.to_le_bytes());
                    // The distance to the entry's representation, then its value, then the representation.
                    let start = self.bytes.len();
                    self.put(0_u64.to_le_bytes());
                    let representation = self.value(entry);
                    let distance = (self.bytes.len() - start) as u64;
                    self.bytes[start..start + 8].copy_from_slice(&distance.to_le_bytes());
                    self.put(representation.to_le_bytes());
                }
                value
            }
        }
    }

    fn plain<T: bytemuck::NoUninit>(&mut self, type_number: u64, numbers: &[T]) -> u64 {
        let value = self.start(type_number);
        self.bytes.extend(bytemuck::cast_slice::<T, u8>(numbers));
        value
    }

    fn array<T: bytemuck::NoUninit>(&mut self, type_number: u64, count: usize, numbers: &[T]) -> u64 {
        if count == 0 {
            return type_number << 48 | IS_ARRAY;
        }
        // Readers map the file into memory and use aligned arrays in place.
        self.bytes.resize(self.bytes.len().next_multiple_of(8), 0);
        let value = self.start(type_number) | IS_ARRAY;
        self.put((count as u64).to_le_bytes());
        self.bytes.extend(bytemuck::cast_slice::<T, u8>(numbers));
        value
    }

    /// Writes the sections and the table of contents.
    fn finish(mut self, root: &PathNode) -> Vec<u8> {
        let mut table: Vec<([u8; 16], usize, usize)> = Vec::new();
        let mut section = |name: &str, content: Vec<u8>| {
            let mut padded = [0; 16];
            padded[..name.len()].copy_from_slice(name.as_bytes());
            table.push((padded, self.bytes.len(), content.len()));
            self.bytes.extend(content);
        };
        section("TOKENS", tokens_section(&self.tokens));
        let mut strings = (self.strings.len() as u64).to_le_bytes().to_vec();
        self.strings.iter().for_each(|token| strings.extend(token.to_le_bytes()));
        section("STRINGS", strings);
        section("FIELDS", fields_section(&self.fields));
        let mut field_sets = (self.field_sets.len() as u64).to_le_bytes().to_vec();
        field_sets.extend(compressed_integers(self.field_sets.iter().map(|n| n.cast_signed())));
        section("FIELDSETS", field_sets);
        section("PATHS", paths_section(self.path_indices.len(), root));
        let mut specs = (self.specs.len() as u64).to_le_bytes().to_vec();
        for part in 0..3 {
            specs.extend(compressed_integers(self.specs.iter().map(|spec| spec[part].cast_signed())));
        }
        section("SPECS", specs);
        let table_at = self.bytes.len() as u64;
        self.put((table.len() as u64).to_le_bytes());
        for (name, start, size) in table {
            self.put(name);
            self.put((start as u64).to_le_bytes());
            self.put((size as u64).to_le_bytes());
        }
        self.bytes[..8].copy_from_slice(MAGIC);
        self.bytes[8..16].copy_from_slice(&VERSION);
        self.bytes[16..24].copy_from_slice(&table_at.to_le_bytes());
        self.bytes
    }
}

/// Representation of an inlined value.
const fn inlined(type_number: u64, payload: u32) -> u64 {
    IS_INLINED | type_number << 48 | payload as u64
}

fn tokens_section(tokens: &[String]) -> Vec<u8> {
    let text: Vec<u8> = tokens.iter().flat_map(|token| token.bytes().chain([0])).collect();
    let packed = compressed(&text);
    let mut section = (tokens.len() as u64).to_le_bytes().to_vec();
    section.extend((text.len() as u64).to_le_bytes());
    section.extend((packed.len() as u64).to_le_bytes());
    section.extend(packed);
    section
}

fn fields_section(fields: &[(u32, u64)]) -> Vec<u8> {
    let values: Vec<u8> = fields.iter().flat_map(|(_, value)| value.to_le_bytes()).collect();
    let packed = compressed(&values);
    let mut section = (fields.len() as u64).to_le_bytes().to_vec();
    section.extend(compressed_integers(fields.iter().map(|(name, _)| name.cast_signed())));
    section.extend((packed.len() as u64).to_le_bytes());
    section.extend(packed);
    section
}

/// The tree of paths in depth-first order: path index, element token and jump of each. Jumps: -2, no child and no
/// sibling; -1, a child follows; 0, a sibling follows; n, a child follows and a sibling n entries on.
fn paths_section(count: usize, root: &PathNode) -> Vec<u8> {
    fn walk(node: &PathNode, has_sibling: bool, rows: &mut Vec<[i32; 3]>) {
        let row = rows.len();
        rows.push([node.index.cast_signed(), node.element, 0]);
        for (i, child) in node.children.iter().enumerate() {
            walk(child, i + 1 < node.children.len(), rows);
        }
        rows[row][2] = match (node.children.is_empty(), has_sibling) {
            (true, false) => -2,
            (false, false) => -1,
            (true, true) => 0,
            (false, true) => (rows.len() - row) as i32,
        };
    }
    let mut rows = Vec::with_capacity(count);
    walk(root, false, &mut rows);
    let mut section = (count as u64).to_le_bytes().to_vec();
    section.extend((rows.len() as u64).to_le_bytes());
    for part in 0..3 {
        section.extend(compressed_integers(rows.iter().map(|row| row[part])));
    }
    section
}

/// LZ4 in one chunk, in the framing of `TfFastCompression`: the leading 0 says that there are no further chunks.
fn compressed(bytes: &[u8]) -> Vec<u8> {
    let mut packed = vec![0];
    packed.extend(lz4_flex::block::compress(bytes));
    packed
}

/// A list of integers, coded and compressed, with its compressed size in front.
fn compressed_integers(numbers: impl Iterator<Item = i32>) -> Vec<u8> {
    let packed = compressed(&coded_integers(numbers));
    let mut bytes = (packed.len() as u64).to_le_bytes().to_vec();
    bytes.extend(packed);
    bytes
}

/// Integers coded as differences: the most common difference, a two-bit code for each (0, the most common one; 1 to 3, one
/// of 8, 16 or 32 bits), then the differences of the other codes.
fn coded_integers(numbers: impl Iterator<Item = i32>) -> Vec<u8> {
    let mut previous = 0_i32;
    let differences: Vec<i32> = numbers
        .map(|number| {
            let difference = number.wrapping_sub(previous);
            previous = number;
            difference
        })
        .collect();
    let mut counts: BTreeMap<i32, usize> = BTreeMap::new();
    for difference in &differences {
        *counts.entry(*difference).or_default() += 1;
    }
    let common_value =
        counts.iter().max_by_key(|(_, count)| **count).map_or(0, |(difference, _)| *difference);
    let mut codes = vec![0_u8; differences.len().div_ceil(4)];
    let mut rest = Vec::new();
    for (i, &difference) in differences.iter().enumerate() {
        let code = if difference == common_value {
            0
        } else if let Ok(small) = i8::try_from(difference) {
            rest.extend(small.to_le_bytes());
            1
        } else if let Ok(medium) = i16::try_from(difference) {
            rest.extend(medium.to_le_bytes());
            2
        } else {
            rest.extend(difference.to_le_bytes());
            3
        };
        codes[i / 4] |= code << (2 * (i % 4));
    }
    [common_value.to_le_bytes().to_vec(), codes, rest].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_coded_as_differences() {
        // The example in OpenUSD's integerCoding.cpp.
        let numbers = [123, 124, 125, 100_125, 100_125, 100_126, 100_126];
        let coded = coded_integers(numbers.into_iter());
        let (common_value, codes) = (1_i32.to_le_bytes(), [0b11_00_00_01, 0b00_01_00_01]);
        let rest = [&[123][..], &100_000_i32.to_le_bytes(), &[0], &[0]].concat();
        assert_eq!(coded, [&common_value[..], &codes, &rest].concat());
    }

    #[test]
    fn paths_are_stored_depth_first() {
        let leaf = |index, element| PathNode { index, element, children: Vec::new() };
        let child = PathNode { index: 1, element: 5, children: vec![leaf(2, -6), leaf(3, 7)] };
        let root = PathNode { index: 0, element: 0, children: vec![child, leaf(4, 8)] };
        let section = paths_section(5, &root);
        let indices = coded_integers([0, 1, 2, 3, 4].into_iter());
        let jumps = coded_integers([-1, 3, 0, -2, -2].into_iter());
        for part in [indices, jumps] {
            let packed = compressed(&part);
            assert!(section.windows(packed.len()).any(|window| window == packed), "{part:?}");
        }
    }
}
