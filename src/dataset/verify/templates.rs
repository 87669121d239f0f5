//! What every file of a frame must look like, whatever the frame shows: taken from a frame of one pixel that the same code
//! encodes.
//!
//! Must not know: folders, rendering.

use serde_json::{Value, json};

use crate::dataset::plan::Plan;
use crate::error::Result;
use crate::frame::{Frame, LabelPixels, LabelReason, RockLabel};
use crate::output::edges::MaskIds;
use crate::output::layout::{FrameLine, Sample};
use crate::output::{self, EncodeInput, EncodedFile, FileKind};

/// A file of an output.
#[derive(Debug)]
pub(super) struct Template {
    pub(super) kind: FileKind,
    /// The file of a frame of one pixel.
    bytes: Vec<u8>,
    /// Whether the file is the same for all frames.
    is_constant: bool,
}

/// The templates of all files of a plan's outputs, in their order.
pub(super) fn of(plan: &Plan) -> Result<Vec<Template>> {
    let encode = |frame: &Frame, meta: &Value| {
        let mask = MaskIds::new(plan.edges);
        let input = EncodeInput { frame, meta, label_ids: plan.label_ids, mask: &mask };
        output::encode(&input, &plan.outputs)
    };
    let first = encode(&pixel(0), &json!({}))?;
    let second = encode(&pixel(1), &json!({ "seed": 1 }))?;
    let templates = first.into_iter().zip(second).map(|(first, second)| Template {
        kind: first.kind(),
        is_constant: first.extension == "json" && first.bytes == second.bytes,
        bytes: first.bytes,
    });
    Ok(templates.collect())
}

/// A frame of one pixel, of this class id.
fn pixel(class: u8) -> Frame {
    let instance = u16::from(class);
    let rock = RockLabel {
        instance,
        visible_px: 1,
        exposed_px: 1,
        box_px: [0; 4],
        height_m: 1.0,
        diameter_m: 1.0,
        reason: LabelReason::Rock,
    };
    Frame {
        width: 1,
        height: 1,
        focal_px: 1.0,
        lens: crate::lens::Lens::default(),
        exposure: crate::frame::ImageExposure::default(),
        rgb: vec![class; 3],
        class: vec![class],
        depth_m: vec![1.0],
        normals: vec![0.0; 3],
        instances: vec![instance],
        sun_occlusion: vec![class],
        radiance: vec![half::f16::ONE; 3],
        samples: 3,
        sample_counts: vec![[1; 3]],
        slope_deg: vec![0.0],
        craters: vec![class],
        incidence_deg: vec![0.0],
        phase_deg: vec![0.0],
        five_classes: vec![class],
        rocks: if instance > 0 { vec![rock] } else { Vec::new() },
        label_pixels: LabelPixels::default(),
    }
}

/// A file that a frame must have.
#[derive(Clone, Debug)]
pub(super) struct ExpectedFile {
    /// Path below the dataset's folder; of a member of an archive, its name.
    pub(super) path: String,
    /// The encoded output that it is a copy of; `None` if the layout encodes it itself.
    pub(super) kind: Option<FileKind>,
    /// The file of a frame of one pixel.
    pub(super) template: Vec<u8>,
    /// Whether its content is that of the template.
    pub(super) is_constant: bool,
}

impl ExpectedFile {
    /// The extension that says what its bytes are: that of its output, whose copy may have another in an archive.
    pub(super) fn extension(&self) -> Option<&str> {
        let of_path = || self.path.rsplit_once('.').map(|(_, extension)| extension);
        self.kind.map(|kind| kind.extension).or_else(of_path)
    }
}

/// The files that a frame must have in its layout.
#[derive(Clone, Debug)]
pub(super) struct ExpectedFrame {
    /// The keys of its hashes.
    pub(super) paths: Vec<String>,
    /// Its files, or its members in an archive.
    pub(super) files: Vec<ExpectedFile>,
    /// Name of the archive, if its layout bundles files.
    pub(super) bundle: Option<String>,
    /// What the layout keeps in the line, as far as it does not depend on what the frame shows.
    pub(super) entry: Value,
}

impl ExpectedFrame {
    /// The files of the frame of a line. `line` gives its index and, where files contain it, its record.
    ///
    /// # Errors
    /// [`crate::Error::Encode`].
    pub(super) fn new(plan: &Plan, templates: &[Template], line: &FrameLine) -> Result<Self> {
        // Each output's file is its number: no encoded image is that short.
        let numbered = (0_u16..).zip(templates).map(|(number, template)| EncodedFile {
            output: template.kind.output,
            stem: template.kind.stem,
            extension: template.kind.extension,
            bytes: number.to_le_bytes().to_vec(),
        });
        let numbered: Vec<EncodedFile> = numbered.collect();
        let record = FrameLine {
            split: plan.split_of(line.index).to_owned(),
            hashes: serde_json::Map::new(),
            entry: Value::Null,
            ms: serde_json::Map::new(),
            ..line.clone()
        };
        let frame = pixel(0);
        let files = plan.layout.frame_files(&Sample { frame: &frame, files: &numbered, record: &record })?;
        let entry = files.entry;
        let bundle = entry.get("bundle").and_then(Value::as_str).map(str::to_owned);
        let paths: Vec<String> = files.artifacts.iter().map(|file| file.name.clone()).collect();
        let contents = match &bundle {
            None => files.artifacts.into_iter().map(|file| (file.name, file.bytes)).collect(),
            Some(_) => {
                let fragments = files.artifacts.iter();
                let members =
                    fragments.filter_map(|file| output::layout::webdataset::members(&file.bytes).ok());
                members.flatten().collect::<Vec<_>>()
            }
        };
        let expected = |(path, bytes): (String, Vec<u8>)| {
            let number = <[u8; 2]>::try_from(&bytes[..]).ok().map(u16::from_le_bytes);
            match number.and_then(|number| templates.get(usize::from(number))) {
                Some(&Template { kind, bytes: ref template, is_constant }) => {
                    ExpectedFile { path, kind: Some(kind), template: template.clone(), is_constant }
                }
                // The record in an archive is known as a whole.
                None => {
                    let is_constant = path.ends_with(".json");
                    ExpectedFile { path, kind: None, template: bytes, is_constant }
                }
            }
        };
        Ok(Self { files: contents.into_iter().map(expected).collect(), paths, bundle, entry })
    }
}
