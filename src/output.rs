//! From a frame to files: one row of [`OUTPUTS`] for each thing a user can ask for.
//!
//! Encoders give bytes; [`disk`] alone touches the disk, and leaves whole files or none; [`writer`] lays out the files of
//! a dataset.
//! Must not know: scene, GPU.
//! To add an output: a row in [`OUTPUTS`] with its encoder.

pub mod basic;
pub mod cityscapes;
pub mod coco;
pub mod disk;
pub mod edges;
pub mod encoders;
pub mod folder;
pub mod hugging_face;
pub mod webdataset;
pub mod writer;

use serde_json::{Map, Value, json};

use crate::class::ClassId;
use crate::error::{Error, Result, nearest};
use crate::frame::{Annotation, Annotations, Frame};
use edges::EdgePolicy;
use encoders::{
    camera_distance_npy, coverage_npy, craters_png, five_classes_json, five_classes_png,
    five_classes_preview_png, hdr_exr, incidence_npy, instances_json, instances_png, labels_json, mask_png,
    meta_json, normals_npy, phase_npy, plane_distance_npy, preview_png, rgb_png, rock_sizes_json,
    rock_sizes_png, shadow_png, slope_npy,
};

/// What the encoders work from.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// The planes.
    pub frame: &'a Frame,
    /// The content of the frame's JSON file.
    pub meta: &'a Value,
    /// Which ids the mask carries.
    pub label_ids: LabelIds,
    /// What the mask says where classes meet.
    pub edges: EdgePolicy,
}

/// A file to be: its name and its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Artifact {
    /// Its path below the output folder.
    pub name: String,
    /// Content.
    pub bytes: Vec<u8>,
}

/// The ids that a mask carries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LabelIds {
    /// Those of [`ClassId`].
    #[default]
    Canonical,
    /// Those that a Replicator pipeline would have given.
    Replicator,
}

impl LabelIds {
    /// Its word in `--label-ids`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Canonical => "canonical",
            Self::Replicator => "replicator",
        }
    }

    /// The kind of a word in `--label-ids`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Canonical, Self::Replicator].into_iter().find(|ids| ids.name() == name)
    }

    /// Those of a dataset, by its manifest.
    #[must_use]
    pub fn of(manifest: &Map<String, Value>) -> Self {
        let name = manifest.get("label_ids").and_then(Value::as_str);
        name.and_then(Self::from_name).unwrap_or_default()
    }

    /// The id that stands in the mask for a class id; unlabelled stays what each system calls so.
    #[must_use]
    pub fn mask_id(self, id: u8) -> u8 {
        match (self, ClassId(id).class()) {
            (Self::Canonical, _) => id,
            (Self::Replicator, Some(class)) => class.replicator_id,
            (Self::Replicator, None) => 1,
        }
    }

    /// Every id that a mask can carry, with its name; by rising id.
    #[must_use]
    pub fn names(self) -> Vec<(u8, &'static str)> {
        let mut rows: Vec<(u8, &'static str)> =
            ClassId::ALL.iter().map(|class| (self.mask_id(class.id.0), class.name)).collect();
        if self == Self::Replicator {
            rows.extend([(0, "BACKGROUND"), (1, "UNLABELLED")]);
        }
        rows.sort_unstable();
        rows
    }

    /// Content of the label file: [`Self::names`] as JSON.
    #[must_use]
    pub fn labels(self) -> Value {
        let rows = self.names().into_iter();
        rows.map(|(id, name)| (id.to_string(), json!({ "class": name }))).collect::<Map<_, _>>().into()
    }

    /// The same in the form of Hugging Face's `id2label`.
    #[must_use]
    pub fn id2label(self) -> Value {
        self.names().into_iter().map(|(id, name)| (id.to_string(), name.into())).collect::<Map<_, _>>().into()
    }
}

type Encoder = fn(&Source<'_>) -> Result<Vec<u8>>;

/// One thing that a user can ask for.
#[derive(Debug)]
pub struct Output {
    /// Its word in `--outputs`.
    pub name: &'static str,
    /// Written unless `--outputs` says otherwise.
    pub default: bool,
    /// What the renderer must add to the frame for it.
    needs: Option<Annotation>,
    /// Stem and extension of each file that it writes, with its encoder; the frame's number stands between.
    files: &'static [(&'static str, &'static str, Encoder)],
}

/// Every output.
pub static OUTPUTS: [Output; 15] = [
    Output { name: "rgb", default: true, needs: None, files: &[("rgb", "png", rgb_png)] },
    Output {
        name: "mask",
        default: true,
        needs: None,
        files: &[
            ("semantic_segmentation", "png", mask_png),
            ("semantic_segmentation_labels", "json", labels_json),
        ],
    },
    Output { name: "preview", default: true, needs: None, files: &[("preview", "png", preview_png)] },
    Output {
        name: "depth",
        default: false,
        needs: Some(Annotation::Depth),
        files: &[
            ("distance_to_image_plane", "npy", plane_distance_npy),
            ("distance_to_camera", "npy", camera_distance_npy),
        ],
    },
    Output {
        name: "normals",
        default: false,
        needs: Some(Annotation::Normals),
        files: &[("normals", "npy", normals_npy)],
    },
    Output {
        name: "instances",
        default: false,
        needs: Some(Annotation::Instances),
        files: &[
            ("instance_segmentation", "png", instances_png),
            ("instance_segmentation_mapping", "json", instances_json),
        ],
    },
    Output {
        name: "shadow",
        default: false,
        needs: Some(Annotation::Shadow),
        files: &[("shadow", "png", shadow_png)],
    },
    Output { name: "hdr", default: false, needs: Some(Annotation::Hdr), files: &[("hdr", "exr", hdr_exr)] },
    Output {
        name: "coverage",
        default: false,
        needs: Some(Annotation::Coverage),
        files: &[("semantic_coverage", "npy", coverage_npy)],
    },
    Output {
        name: "slope",
        default: false,
        needs: Some(Annotation::Slope),
        files: &[("slope", "npy", slope_npy)],
    },
    Output {
        name: "craters",
        default: false,
        needs: Some(Annotation::Craters),
        files: &[("craters", "png", craters_png)],
    },
    Output {
        name: "angles",
        default: false,
        needs: Some(Annotation::Angles),
        files: &[("incidence", "npy", incidence_npy), ("phase", "npy", phase_npy)],
    },
    Output {
        name: "five_classes",
        default: false,
        needs: Some(Annotation::FiveClasses),
        files: &[
            ("five_classes", "png", five_classes_png),
            ("five_classes_preview", "png", five_classes_preview_png),
            ("five_classes_labels", "json", five_classes_json),
        ],
    },
    Output {
        name: "rock_sizes",
        default: false,
        needs: Some(Annotation::Instances),
        files: &[("rock_sizes", "png", rock_sizes_png), ("rock_sizes_labels", "json", rock_sizes_json)],
    },
    Output { name: "meta", default: true, needs: None, files: &[("frame", "json", meta_json)] },
];

/// What the renderer must add to the frame for these outputs.
#[must_use]
pub fn annotations(outputs: &[&'static Output]) -> Annotations {
    outputs.iter().filter_map(|output| output.needs).collect()
}

impl Output {
    /// Stem and extension of each of its files.
    pub fn kinds(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        self.files.iter().map(|&(stem, extension, _)| (stem, extension))
    }

    /// Names of the files that it writes for frame `index`.
    pub fn file_names(&self, index: u64) -> impl Iterator<Item = String> {
        self.files.iter().map(move |(stem, extension, _)| frame_file_name(stem, index, extension))
    }
}

/// The outputs that are written unless others are asked for, as a comma-separated list.
#[must_use]
pub fn default_list() -> String {
    let names: Vec<&str> = OUTPUTS.iter().filter(|output| output.default).map(|output| output.name).collect();
    names.join(",")
}

/// The outputs of a comma-separated list; `all` is every one.
///
/// # Errors
/// [`Error::Usage`] for an unknown word.
pub fn parse_outputs(list: &str) -> Result<Vec<&'static Output>> {
    let words: Vec<&str> = list.split(',').map(str::trim).filter(|word| !word.is_empty()).collect();
    if words.is_empty() {
        return Err(Error::Usage("--outputs is empty; name at least one, or leave it out".to_owned()));
    }
    let known = || OUTPUTS.iter().map(|output| output.name);
    if let Some(unknown) = words.iter().find(|word| **word != "all" && !known().any(|name| name == **word)) {
        let meant =
            nearest(unknown, known()).map_or_else(String::new, |name| format!(" (did you mean `{name}`?)"));
        let names: Vec<&str> = known().collect();
        return Err(Error::Usage(format!(
            "--outputs: unknown output `{unknown}`{meant}; there are {} and all",
            names.join(", ")
        )));
    }
    Ok(OUTPUTS.iter().filter(|output| words.contains(&"all") || words.contains(&output.name)).collect())
}

/// One encoded output of a frame, before a layout gives it its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoded {
    /// The word in `--outputs` that it belongs to.
    pub output: &'static str,
    /// What it is: the part of its file name before the frame's number.
    pub stem: &'static str,
    /// Extension of its file name.
    pub extension: &'static str,
    /// Content.
    pub bytes: Vec<u8>,
}

/// The encoded outputs of a frame.
///
/// # Errors
/// [`Error::Encode`].
pub fn encode(source: &Source<'_>, outputs: &[&'static Output]) -> Result<Vec<Encoded>> {
    let files = outputs.iter().flat_map(|output| output.files.iter().map(|file| (output.name, file)));
    files
        .map(|(output, &(stem, extension, encoder))| {
            let bytes = encoder(source).map_err(|error| match error {
                Error::Encode { message, .. } => Error::Encode { name: stem.to_owned(), message },
                other => other,
            })?;
            Ok(Encoded { output, stem, extension, bytes })
        })
        .collect()
}

impl Encoded {
    /// The file that it is when a frame stands alone.
    #[must_use]
    pub fn into_artifact(self, index: u64) -> Artifact {
        Artifact { name: frame_file_name(self.stem, index, self.extension), bytes: self.bytes }
    }
}

fn frame_file_name(stem: &str, index: u64, extension: &str) -> String {
    format!("{stem}_{index:04}.{extension}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::RockLabel;

    fn frame() -> Frame {
        Frame {
            width: 3,
            height: 2,
            focal_px: 2.0,
            lens: crate::lens::Lens::default(),
            rgb: (0..18).map(|i| i * 14).collect(),
            class: vec![0, 1, 2, 2, 1, 255],
            depth_m: vec![1.0, 2.0, f32::INFINITY, 4.0, 5.0, 6.0],
            normals: (0..18).map(|i| i as f32).collect(),
            instances: vec![0, 300, 0, 0, 2, 0],
            sun_occlusion: vec![0, 10, 20, 30, 40, 255],
            radiance: (0..18).map(|i| half::f16::from_f32(i as f32 * 0.25)).collect(),
            sample_counts: vec![[4, 0, 0], [1, 3, 0], [0, 0, 4], [0, 2, 2], [0, 4, 0], [1, 1, 2]],
            rocks: vec![RockLabel {
                instance: 300,
                visible_px: 1,
                exposed_px: 4,
                box_px: [1, 0, 1, 0],
                height_m: 0.5,
                diameter_m: 1.25,
            }],
            slope_deg: vec![1.0, f32::NAN, 3.0, 4.0, 5.0, 6.0],
            craters: vec![0, 1, 2, 0, 0, 1],
            incidence_deg: vec![10.0; 6],
            phase_deg: vec![20.0; 6],
            five_classes: vec![0, 1, 2, 3, 4, 0],
        }
    }

    #[test]
    fn annotations_come_back_as_they_went() {
        let bytes = |name: &str| encoded(name, LabelIds::Canonical);
        let floats = |name: &str, shape: &str| {
            let bytes = bytes(name);
            let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
            let header = String::from_utf8_lossy(&bytes[10..data]).into_owned();
            assert!(bytes.starts_with(b"\x93NUMPY\x01\x00") && data % 64 == 0 && header.ends_with('\n'));
            assert!(header.contains(&format!("'shape': ({shape})")) && header.contains("'<f4'"), "{header}");
            bytes[data..]
                .chunks_exact(4)
                .map(|f| f32::from_le_bytes([f[0], f[1], f[2], f[3]]))
                .collect::<Vec<_>>()
        };
        assert_eq!(floats("distance_to_image_plane_0007.npy", "2, 3"), frame().depth_m);
        assert_eq!(floats("normals_0007.npy", "2, 3, 3"), frame().normals);
        assert_eq!(floats("semantic_coverage_0007.npy", "2, 3, 3")[3..6], [0.25, 0.75, 0.0]);
        let along_ray = floats("distance_to_camera_0007.npy", "2, 3");
        // The first pixel's centre is a pixel left of and half a pixel above the middle; the focal length is 2 px.
        assert!((along_ray[0] - (1.0_f32 + 0.25 + 0.0625).sqrt()).abs() < 1e-6 && along_ray[2].is_infinite());
        let instances = decoded("instance_segmentation_0007.png", LabelIds::Canonical);
        assert_eq!(instances.color(), image::ColorType::L16);
        assert_eq!(instances.into_luma16().into_raw(), frame().instances);
        assert_eq!(decoded("shadow_0007.png", LabelIds::Canonical).as_bytes(), frame().sun_occlusion);
        let mapping: Value =
            serde_json::from_slice(&bytes("instance_segmentation_mapping_0007.json")).expect("JSON");
        assert_eq!(mapping["300"]["path"], "/World/Rocks/Rock_299");
        assert_eq!(mapping["300"]["occluded"], 0.75);
        assert_eq!((&mapping["300"]["height_m"], &mapping["300"]["diameter_m"]), (&json!(0.5), &json!(1.25)));
        assert!(floats("slope_0007.npy", "2, 3")[1].is_nan() && floats("phase_0007.npy", "2, 3")[0] == 20.0);
        assert_eq!(decoded("craters_0007.png", LabelIds::Canonical).as_bytes(), frame().craters);
        assert_eq!(decoded("five_classes_0007.png", LabelIds::Canonical).as_bytes(), frame().five_classes);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("hdr.exr");
        std::fs::write(&path, bytes("hdr_0007.exr")).expect("written");
        let image = exr::prelude::read_first_rgba_layer_from_file(
            &path,
            |_, _| vec![[0.0_f32; 3]; 6],
            |pixels: &mut Vec<[f32; 3]>, at: exr::math::Vec2<usize>, (r, g, b, _): (f32, f32, f32, f32)| {
                pixels[at.y() * 3 + at.x()] = [r, g, b];
            },
        )
        .expect("an OpenEXR file");
        let expected: Vec<f32> = frame().radiance.iter().map(|value| value.to_f32()).collect();
        assert_eq!(image.layer_data.channel_data.pixels.concat(), expected);
    }

    fn encoded(name: &str, label_ids: LabelIds) -> Vec<u8> {
        let (frame, meta) = (frame(), json!({}));
        let source = Source { frame: &frame, meta: &meta, label_ids, edges: EdgePolicy::Hard };
        let outputs = parse_outputs("all").expect("all");
        let encoded = encode(&source, &outputs).expect("encoded");
        let mut artifacts = encoded.into_iter().map(|file| file.into_artifact(7));
        artifacts.find(|artifact| artifact.name == name).expect(name).bytes
    }

    fn decoded(name: &str, label_ids: LabelIds) -> image::DynamicImage {
        image::load_from_memory(&encoded(name, label_ids)).expect("a picture")
    }

    #[test]
    fn pictures_come_back_as_they_went() {
        assert_eq!(
            decoded("rgb_0007.png", LabelIds::Canonical),
            image::DynamicImage::ImageRgb8(image::RgbImage::from_raw(3, 2, frame().rgb).expect("a picture"))
        );
        let mask = decoded("semantic_segmentation_0007.png", LabelIds::Canonical);
        assert_eq!(mask.color(), image::ColorType::L8);
        assert_eq!(mask.as_bytes(), frame().class);
        let raw = decoded("semantic_segmentation_0007.png", LabelIds::Replicator);
        assert_eq!(raw.as_bytes(), [4, 3, 2, 2, 3, 1]);
        let preview = decoded("preview_0007.png", LabelIds::Replicator);
        assert_eq!(preview.as_bytes()[..9], [170, 140, 110, 220, 45, 40, 70, 120, 205]);
        assert_eq!(preview.as_bytes()[15..], [0, 0, 0]);
    }

    #[test]
    fn rocks_are_told_apart_by_size_in_colours_that_collapse_to_three() {
        let colours = decoded("rock_sizes_0007.png", LabelIds::Canonical).into_rgb8().into_raw();
        // Rock 300 is 1.25 m across; rock 2 is not in the list.
        let expected = [[0, 0, 0], [0, 0, 255], [255, 0, 0], [255, 0, 0], [0, 255, 0], [0, 0, 0]];
        assert_eq!(colours, expected.concat());
        let labels: Value =
            serde_json::from_slice(&encoded("rock_sizes_labels_0007.json", LabelIds::Canonical))
                .expect("JSON");
        for (rgb, id) in colours.chunks_exact(3).zip(&frame().class[..5]) {
            let name = labels[format!("({}, {}, {}, 255)", rgb[0], rgb[1], rgb[2])]["class"].as_str();
            let class = name.and_then(|name| name.split(',').next());
            assert_eq!(class, ClassId(*id).class().map(|class| class.name));
        }
    }

    #[test]
    fn label_files_name_every_id() {
        let text = |ids: LabelIds| ids.labels().to_string();
        assert_eq!(
            text(LabelIds::Canonical),
            r#"{"0":{"class":"regolith"},"1":{"class":"rock"},"2":{"class":"sky"}}"#
        );
        assert_eq!(
            text(LabelIds::Replicator),
            r#"{"0":{"class":"BACKGROUND"},"1":{"class":"UNLABELLED"},"2":{"class":"sky"},"3":{"class":"rock"},"4":{"class":"regolith"}}"#
        );
    }

    #[test]
    fn output_lists_are_checked() {
        let names =
            |list| parse_outputs(list).map(|outputs| outputs.iter().map(|o| o.name).collect::<Vec<_>>());
        assert_eq!(names("mask, rgb").expect("known"), ["rgb", "mask"]);
        assert_eq!(names("all").expect("known").len(), OUTPUTS.len());
        let message = names("rgb,masks").expect_err("unknown").to_string();
        assert!(message.contains("`masks`") && message.contains("did you mean `mask`"), "{message}");
        assert!(names(",").is_err());
    }
}
