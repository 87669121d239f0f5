//! From a frame to files: one row of [`OUTPUTS`] for each value of `--outputs`.
//!
//! [`mod@encode`] turns planes into bytes, [`layout`] decides where the files of a dataset go, and [`disk`] alone touches the
//! disk and leaves whole files or none.
//! Must not know: scene, GPU.
//! To add an output: a row in [`OUTPUTS`] with its encoder.

pub mod arrays;
pub mod artifact;
pub mod dataset_path;
pub mod disk;
pub mod edges;
pub mod encode;
pub mod label_ids;
pub mod layout;

use std::path::Path;

use crate::error::{Error, Result, nearest};
use crate::frame::plane::{PLANES, PlaneRow};
use crate::frame::{Annotation, Annotations, Frame};
use artifact::frame_file_name;
pub use artifact::{Artifact, EncodedFile, FileKind};
pub use encode::EncodeInput;
pub use encode::json::rocks_json;
use encode::{exr, json, npy, png};
pub use label_ids::LabelIds;

type Encoder = fn(&EncodeInput<'_>) -> Result<Vec<u8>>;

/// What one value of `--outputs` stands for.
#[derive(Debug)]
pub struct Output {
    /// Its name in `--outputs`.
    pub name: &'static str,
    /// Whether it is written when `--outputs` is not given.
    pub default: bool,
    /// The annotation that the renderer must produce for it.
    needs: Option<Annotation>,
    /// Stem, extension and encoder of each of its files; the frame number goes between stem and extension.
    files: &'static [(&'static str, &'static str, Encoder)],
}

/// Every output.
pub static OUTPUTS: [Output; 15] = [
    Output { name: "rgb", default: true, needs: None, files: &[("rgb", "png", png::rgb)] },
    Output {
        name: "mask",
        default: true,
        needs: None,
        files: &[
            ("semantic_segmentation", "png", png::mask),
            ("semantic_segmentation_labels", "json", json::labels),
        ],
    },
    Output { name: "preview", default: true, needs: None, files: &[("preview", "png", png::preview)] },
    Output {
        name: "depth",
        default: false,
        needs: Some(Annotation::Depth),
        files: &[
            ("distance_to_image_plane", "npy", npy::plane_distance),
            ("distance_to_camera", "npy", npy::camera_distance),
        ],
    },
    Output {
        name: "normals",
        default: false,
        needs: Some(Annotation::Normals),
        files: &[("normals", "npy", npy::normals)],
    },
    Output {
        name: "instances",
        default: false,
        needs: Some(Annotation::Instances),
        files: &[
            ("instance_segmentation", "png", png::instances),
            ("instance_segmentation_mapping", "json", json::instance_mapping),
        ],
    },
    Output {
        name: "shadow",
        default: false,
        needs: Some(Annotation::Shadow),
        files: &[("shadow", "png", png::shadow)],
    },
    Output {
        name: "hdr",
        default: false,
        needs: Some(Annotation::Hdr),
        files: &[("hdr", "exr", exr::radiance)],
    },
    Output {
        name: "coverage",
        default: false,
        needs: Some(Annotation::Coverage),
        files: &[("semantic_coverage", "npy", npy::coverage)],
    },
    Output {
        name: "slope",
        default: false,
        needs: Some(Annotation::Slope),
        files: &[("slope", "npy", npy::slope)],
    },
    Output {
        name: "craters",
        default: false,
        needs: Some(Annotation::Craters),
        files: &[("craters", "png", png::craters)],
    },
    Output {
        name: "angles",
        default: false,
        needs: Some(Annotation::Angles),
        files: &[("incidence", "npy", npy::incidence), ("phase", "npy", npy::phase)],
    },
    Output {
        name: "five_classes",
        default: false,
        needs: Some(Annotation::FiveClasses),
        files: &[
            ("five_classes", "png", png::five_classes),
            ("five_classes_preview", "png", png::five_classes_preview),
            ("five_classes_labels", "json", json::five_classes),
        ],
    },
    Output {
        name: "rock_sizes",
        default: false,
        needs: Some(Annotation::Instances),
        files: &[("rock_sizes", "png", png::rock_sizes), ("rock_sizes_labels", "json", json::rock_sizes)],
    },
    Output { name: "meta", default: true, needs: None, files: &[("frame", "json", json::meta)] },
];

/// The annotations that the renderer must produce for these outputs.
#[must_use]
pub fn annotations(outputs: &[&'static Output]) -> Annotations {
    outputs.iter().filter_map(|output| output.needs).collect()
}

impl Output {
    /// Checks that a frame has a value for every pixel of the planes that it needs besides colour and class.
    fn check_planes(&self, frame: &Frame) -> Result<()> {
        let pixels = frame.width as usize * frame.height as usize;
        let is_needed = |row: &&PlaneRow| row.annotation.is_some() && row.annotation == self.needs;
        let is_incomplete = |row: &&PlaneRow| frame.plane(row.plane).len() != pixels * row.channels;
        PLANES.iter().filter(is_needed).find(is_incomplete).map_or(Ok(()), |row| {
            Err(Error::Encode {
                name: self.files[0].0.to_owned(),
                message: format!(
                    "the frame has no `{}`, one for each pixel; render it with the annotations of the output {}",
                    row.name, self.name
                ),
            })
        })
    }

    /// The kind of each of its files.
    pub fn file_kinds(&self) -> impl Iterator<Item = FileKind> {
        self.files.iter().map(|&(stem, extension, _)| FileKind { output: self.name, stem, extension })
    }

    /// Names of its files for frame `index`, as written for a single frame.
    pub fn file_names(&self, index: u64) -> impl Iterator<Item = String> {
        self.files.iter().map(move |(stem, extension, _)| frame_file_name(stem, index, extension))
    }
}

/// Names of the default outputs, as a comma-separated list.
#[must_use]
pub fn default_list() -> String {
    let names: Vec<&str> = OUTPUTS.iter().filter(|output| output.default).map(|output| output.name).collect();
    names.join(",")
}

/// The outputs that the comma-separated list of `--outputs` names; `all` stands for every output.
///
/// # Errors
/// [`Error::Usage`] for an empty list, [`Error::UnknownOutput`].
pub fn parse_outputs(list: &str) -> Result<Vec<&'static Output>> {
    parse_outputs_of("--outputs", list)
}

/// The same of the list of another option.
///
/// # Errors
/// As [`parse_outputs`].
pub fn parse_outputs_of(option: &'static str, list: &str) -> Result<Vec<&'static Output>> {
    let words: Vec<&str> = list.split(',').map(str::trim).filter(|word| !word.is_empty()).collect();
    if words.is_empty() {
        return Err(Error::Usage(format!(
            "{option}: the list of outputs is empty; name at least one, or leave it out"
        )));
    }
    let known = || OUTPUTS.iter().map(|output| output.name);
    if let Some(unknown) = words.iter().find(|word| **word != "all" && !known().any(|name| name == **word)) {
        return Err(Error::UnknownOutput {
            option,
            name: (*unknown).to_owned(),
            suggestion: nearest(unknown, known()),
            available: known().map(str::to_owned).collect(),
        });
    }
    Ok(OUTPUTS.iter().filter(|output| words.contains(&"all") || words.contains(&output.name)).collect())
}

/// Encodes these outputs of a frame, which must have been rendered with their [`annotations`].
///
/// # Errors
/// [`Error::Encode`] with the stem of the file that failed, also where the frame lacks a plane of it.
pub fn encode(input: &EncodeInput<'_>, outputs: &[&'static Output]) -> Result<Vec<EncodedFile>> {
    outputs.iter().try_for_each(|output| output.check_planes(input.frame))?;
    let files = outputs.iter().flat_map(|output| output.files.iter().map(|file| (output.name, file)));
    files
        .map(|(output, &(stem, extension, encoder))| {
            let bytes = encoder(input).map_err(|error| match error {
                Error::Encode { message, .. } => Error::Encode { name: stem.to_owned(), message },
                other => other,
            })?;
            Ok(EncodedFile { output, stem, extension, bytes })
        })
        .collect()
}

/// Refuses `folder` if it is a file, or holds anything that frame `index` would not have written.
///
/// # Errors
/// [`Error::OutIsFile`], [`Error::OutNotEmpty`] unless `force`, [`Error::Read`] if the folder cannot be listed.
pub fn check_folder(folder: &Path, index: u64, force: bool) -> Result<()> {
    let names: Vec<String> = OUTPUTS.iter().flat_map(|output| output.file_names(index)).collect();
    disk::check_content(folder, force, |found| names.iter().any(|name| name == found))
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::class::ClassId;
    use crate::frame::{Frame, LabelPixels, LabelReason, RockLabel};
    use edges::{EdgePolicy, MaskIds};

    fn frame() -> Frame {
        Frame {
            width: 3,
            height: 2,
            focal_px: 2.0,
            lens: crate::lens::Lens::default(),
            exposure: crate::frame::ImageExposure::default(),
            samples: 4,
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
                reason: LabelReason::Unseen,
            }],
            slope_deg: vec![1.0, f32::NAN, 3.0, 4.0, 5.0, 6.0],
            craters: vec![0, 1, 2, 0, 0, 1],
            incidence_deg: vec![10.0; 6],
            phase_deg: vec![20.0; 6],
            five_classes: vec![0, 1, 2, 3, 4, 255],
            label_pixels: LabelPixels::default(),
        }
    }

    #[test]
    fn a_frame_without_a_plane_of_an_output_is_no_file() {
        let (meta, mask) = (json!({}), MaskIds::default());
        let encoded = |frame: &Frame| {
            let input = EncodeInput { frame, meta: &meta, label_ids: LabelIds::Canonical, mask: &mask };
            OUTPUTS.iter().map(|output| (output.name, encode(&input, &[output]))).collect::<Vec<_>>()
        };
        let plain = Frame { depth_m: Vec::new(), normals: Vec::new(), instances: Vec::new(), ..frame() };
        for (name, result) in encoded(&plain) {
            let lacks = matches!(name, "depth" | "normals" | "instances" | "rock_sizes");
            match result {
                Ok(files) => assert!(!lacks && !files.is_empty(), "{name}"),
                Err(error) => assert!(lacks && error.to_string().contains(name), "{name}: {error}"),
            }
        }
    }

    #[test]
    fn annotations_survive_a_round_trip() {
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
        let image = ::exr::prelude::read_first_rgba_layer_from_file(
            &path,
            |_, _| vec![[0.0_f32; 3]; 6],
            |pixels: &mut Vec<[f32; 3]>, at: ::exr::math::Vec2<usize>, (r, g, b, _): (f32, f32, f32, f32)| {
                pixels[at.y() * 3 + at.x()] = [r, g, b];
            },
        )
        .expect("an OpenEXR file");
        let expected: Vec<f32> = frame().radiance.iter().map(|value| value.to_f32()).collect();
        assert_eq!(image.layer_data.channel_data.pixels.concat(), expected);
    }

    fn encoded(name: &str, label_ids: LabelIds) -> Vec<u8> {
        let (frame, meta) = (frame(), json!({}));
        let mask = MaskIds::default();
        let input = EncodeInput { frame: &frame, meta: &meta, label_ids, mask: &mask };
        let outputs = parse_outputs("all").expect("all");
        let encoded = encode(&input, &outputs).expect("encoded");
        let mut artifacts = encoded.into_iter().map(|file| file.into_artifact(7));
        artifacts.find(|artifact| artifact.name == name).expect(name).bytes
    }

    fn decoded(name: &str, label_ids: LabelIds) -> image::DynamicImage {
        image::load_from_memory(&encoded(name, label_ids)).expect("an image")
    }

    #[test]
    fn arrays_hold_the_values_of_the_files() {
        use crate::frame::plane::OwnedValues;
        let (outputs, [width, height]) = (parse_outputs("all").expect("all"), [3_u32, 2]);
        let mask = MaskIds::new(EdgePolicy::Ignore(1));
        let arrays = arrays::arrays(frame(), &outputs, &mask);
        let meta = json!({});
        let input = EncodeInput { frame: &frame(), meta: &meta, label_ids: LabelIds::Canonical, mask: &mask };
        let mut files = encode(&input, &outputs).expect("encoded");
        files.retain(|file| file.extension != "json");
        assert_eq!(arrays.len(), files.len(), "every file that is no text is an array");
        for (array, file) in arrays.iter().zip(&files) {
            assert!(array.name == file.stem || (array.name, file.stem) == ("mask", "semantic_segmentation"));
            let image = || image::load_from_memory(&file.bytes).expect("an image");
            let values = (width * height) as usize * array.channels;
            match (&array.values, file.extension) {
                (OwnedValues::U8(found), "png") => assert_eq!(image().as_bytes(), found, "{}", array.name),
                (OwnedValues::U16(found), "png") => assert_eq!(image().into_luma16().into_raw(), *found),
                (OwnedValues::F32(found), "npy") => {
                    let stored = &file.bytes[file.bytes.len() - 4 * values..];
                    assert_eq!(stored, bytemuck::cast_slice::<f32, u8>(found), "{}", array.name);
                }
                (OwnedValues::F16(found), "exr") => assert_eq!(*found, frame().radiance),
                (other, extension) => panic!("{}: {other:?} in {extension}", array.name),
            }
        }
    }

    #[test]
    fn an_edge_policy_holds_for_every_form_of_the_mask() {
        let (frame, meta, mask) = (frame(), json!({}), MaskIds::new(EdgePolicy::Ignore(1)));
        let input = EncodeInput { frame: &frame, meta: &meta, label_ids: LabelIds::Canonical, mask: &mask };
        let files = encode(&input, &parse_outputs("mask,five_classes,rock_sizes").expect("outputs"))
            .expect("encoded");
        let pixels = |stem: &str| {
            let file = files.iter().find(|file| file.stem == stem && file.extension == "png").expect(stem);
            image::load_from_memory(&file.bytes).expect("an image").into_bytes()
        };
        // Every pixel is beside another class.
        assert_eq!(pixels("semantic_segmentation"), [255; 6]);
        assert_eq!(pixels("five_classes"), [255; 6]);
        assert_eq!(pixels("five_classes_preview"), [0; 18]);
        assert_eq!(pixels("rock_sizes"), [255; 18]);
    }

    #[test]
    fn images_survive_a_round_trip() {
        assert_eq!(
            decoded("rgb_0007.png", LabelIds::Canonical),
            image::DynamicImage::ImageRgb8(image::RgbImage::from_raw(3, 2, frame().rgb).expect("an image"))
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
    fn rock_size_colours_map_back_to_the_mask_classes() {
        let colours = decoded("rock_sizes_0007.png", LabelIds::Canonical).into_rgb8().into_raw();
        // Rock 300 is 1.25 m across; rock 2 is not in the list.
        let expected = [[0, 0, 0], [0, 0, 255], [255, 0, 0], [255, 0, 0], [0, 255, 0], [255; 3]];
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
    fn a_folder_with_other_content_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        assert!(check_folder(folder.path(), 0, false).is_ok());
        std::fs::write(folder.path().join("rgb_0000.png"), "old").expect("written");
        assert!(check_folder(folder.path(), 0, false).is_ok(), "an earlier frame may be replaced");
        std::fs::write(folder.path().join("thesis.tex"), "years of work").expect("written");
        let error = check_folder(folder.path(), 0, false).expect_err("other content");
        assert!(error.to_string().contains("thesis.tex") && error.exit_status() == 2);
        assert!(check_folder(folder.path(), 0, true).is_ok());
        assert!(matches!(check_folder(&folder.path().join("thesis.tex"), 0, true), Err(Error::OutIsFile(_))));
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
