//! Exported files, read back by independent readers and compared with the scene.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::io::{Cursor, Read as _};

use regolith::class::ClassId;
use regolith::export::{Detail, Format, Stage, export};
use regolith::params::Params;
use regolith::render::RenderSettings;
use regolith::render::select::selection::Selection;
use regolith::scene::Scene;
use serde_json::{Map, Value};

use super::support::{folder, json, params, run_ok};

const SEED: u64 = 11;
const SIZE: [u32; 2] = [256, 128];

struct Subject {
    scene: Scene,
    knobs: Map<String, Value>,
    settings: RenderSettings,
}

impl Subject {
    fn new(seed: u64, set: &[&str]) -> Self {
        let params: Params = params(seed, set);
        let scene = Scene::build(seed, &params).unwrap_or_else(|error| panic!("{error}"));
        Self { scene, knobs: params.to_json(), settings: RenderSettings::new(SIZE, 4).expect("settings") }
    }

    fn export(&self, format: Format, detail: Detail) -> Vec<u8> {
        let Self { scene, knobs, settings } = self;
        export(&Stage { scene, seed: SEED, knobs, settings, detail }, format).expect("exported")
    }

    /// Instance, class and number of triangles of each object that a file must hold, in order.
    fn expected(&self, detail: Detail) -> Vec<(u16, ClassId, usize)> {
        let cells = self.scene.terrain.columns as usize;
        let mut expected = vec![(0, ClassId::REGOLITH, 2 * cells * cells)];
        let row = |rock: usize, level: usize| (rock as u16 + 1, ClassId::ROCK, 20_usize << (2 * level));
        match detail {
            Detail::Authored => {
                expected.extend(self.scene.rocks.iter().map(|rock| row(rock.index as usize, rock.level)));
            }
            Detail::Drawn => {
                for selected in Selection::new(&self.scene, &self.settings).rocks {
                    let level = match (selected.visible_level, selected.caster) {
                        (Some(level), _) | (None, Some((_, level))) => level,
                        (None, None) => panic!("selected, but neither visible nor a caster"),
                    };
                    expected.push(row(selected.rock, level));
                }
            }
        }
        expected
    }
}

/// A member of the archive: type, shape, data.
type Array = (String, Vec<usize>, Vec<u8>);

/// Every member by name; checks that its header matches the length of its data.
fn arrays(bytes: &[u8]) -> BTreeMap<String, Array> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).expect("a zip");
    let mut arrays = BTreeMap::new();
    for index in 0..archive.len() {
        let mut file = archive.by_index(index).expect("a member");
        assert_eq!(file.compression(), zip::CompressionMethod::Stored);
        let name = file.name().expect("a name").strip_suffix(".npy").expect("an array").to_owned();
        let mut content = Vec::new();
        file.read_to_end(&mut content).expect("complete, with the right checksum");
        assert_eq!(content[..8], *b"\x93NUMPY\x01\x00", "{name}");
        let data = 10 + usize::from(u16::from_le_bytes([content[8], content[9]]));
        assert_eq!(data % 64, 0, "{name}");
        let header = std::str::from_utf8(&content[10..data]).expect("text");
        assert!(header.ends_with('\n') && header.contains("'fortran_order': False"), "{name}: {header}");
        let between = |start: &str, end: &str| {
            let rest = header.split_once(start).unwrap_or_else(|| panic!("{name}: {header}")).1;
            rest.split_once(end).unwrap_or_else(|| panic!("{name}: {header}")).0.to_owned()
        };
        let kind = between("'descr': '", "'");
        let shape: Vec<usize> = between("'shape': (", ")")
            .split(',')
            .filter(|n| !n.trim().is_empty())
            .map(|n| n.trim().parse().expect("a number"))
            .collect();
        let item: usize = kind[2..].parse().expect("a size");
        assert_eq!(content.len() - data, item * shape.iter().product::<usize>(), "{name}");
        arrays.insert(name, (kind, shape, content.split_off(data)));
    }
    arrays
}

fn f32s(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn f64s(bytes: &[u8]) -> Vec<f64> {
    bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight"))).collect()
}

fn u32s(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn u16s(bytes: &[u8]) -> Vec<u16> {
    bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
}

/// Instance, class and length of each run of consecutive triangles.
fn runs(instances: &[u16], classes: &[u8]) -> Vec<(u16, ClassId, usize)> {
    let mut runs: Vec<(u16, ClassId, usize)> = Vec::new();
    for (&instance, &class) in instances.iter().zip(classes) {
        match runs.last_mut() {
            Some(run) if (run.0, run.1) == (instance, ClassId(class)) => run.2 += 1,
            _ => runs.push((instance, ClassId(class), 1)),
        }
    }
    runs
}

#[test]
fn arrays_have_their_types_and_shapes_and_rocks_their_class_and_instance() {
    let subject = Subject::new(SEED, &[]);
    for detail in [Detail::Authored, Detail::Drawn] {
        let arrays = arrays(&subject.export(Format::Npz, detail));
        let expected = subject.expected(detail);
        let triangles: usize = expected.iter().map(|(.., count)| count).sum();
        let vertices = arrays["vertices"].1[0];
        let instances = subject.scene.rocks.len() + 1;
        let layout: Vec<(&str, &str, &[usize])> = arrays
            .iter()
            .map(|(name, (kind, shape, _))| (name.as_str(), kind.as_str(), &shape[..]))
            .collect();
        assert_eq!(
            layout,
            [
                ("K", "<f8", &[3, 3][..]),
                ("albedo", "<f4", &[instances, 3]),
                ("normals", "<f4", &[vertices, 3]),
                ("sun_direction", "<f4", &[3]),
                ("triangle_class", "|u1", &[triangles]),
                ("triangle_instance", "<u2", &[triangles]),
                ("triangles", "<u4", &[triangles, 3]),
                ("vertices", "<f4", &[vertices, 3]),
                ("world_from_camera", "<f8", &[4, 4]),
            ]
        );
        assert_eq!(runs(&u16s(&arrays["triangle_instance"].2), &arrays["triangle_class"].2), expected);
        let corners = u32s(&arrays["triangles"].2);
        let used: HashSet<u32> = corners.iter().copied().collect();
        assert_eq!(used.len(), vertices, "every vertex belongs to a triangle");
        assert!(corners.iter().all(|&v| (v as usize) < vertices));
        let albedo = f32s(&arrays["albedo"].2);
        assert_eq!(albedo[..3], subject.scene.regolith.albedo.to_array());
        for rock in &subject.scene.rocks {
            let row = 3 * (rock.index as usize + 1);
            assert_eq!(albedo[row..row + 3], rock.material.albedo.to_array());
        }
        assert_eq!(f32s(&arrays["sun_direction"].2), subject.scene.sun.direction.to_array());
        for normal in f32s(&arrays["normals"].2).chunks_exact(3) {
            let length = normal.iter().map(|n| n * n).sum::<f32>().sqrt();
            assert!((length - 1.0).abs() < 1e-4, "{normal:?}");
        }
    }
}

#[test]
fn vertices_are_at_the_world_positions_of_the_scene() {
    let subject = Subject::new(SEED, &[]);
    let arrays = arrays(&subject.export(Format::Npz, Detail::Authored));
    let (vertices, corners) = (f32s(&arrays["vertices"].2), u32s(&arrays["triangles"].2));
    let instances = u16s(&arrays["triangle_instance"].2);
    for rock in &subject.scene.rocks {
        let first = instances.iter().position(|&id| u32::from(id) == rock.index + 1).expect("its triangles");
        for (i, triangle) in rock.triangles(rock.level).iter().enumerate() {
            for (j, &v) in triangle.iter().enumerate() {
                let corner = 3 * corners[3 * (first + i) + j] as usize;
                let position = rock.vertices[v as usize].position + rock.centre;
                assert_eq!(vertices[corner..corner + 3], position.to_array(), "rock {}", rock.index);
            }
        }
    }
}

#[test]
fn drawn_geometry_is_a_subset_of_authored_geometry() {
    // The camera looks away from most rocks, so that some are neither visible nor casters.
    let subject = Subject::new(SEED, &["camera.yaw_deg=150"]);
    let (authored, drawn) = (subject.expected(Detail::Authored), subject.expected(Detail::Drawn));
    assert!(drawn.len() < authored.len(), "every rock is drawn: this view tests nothing");
    let positions = |detail| {
        let arrays = arrays(&subject.export(Format::Npz, detail));
        assert_eq!(
            runs(&u16s(&arrays["triangle_instance"].2), &arrays["triangle_class"].2),
            subject.expected(detail)
        );
        let data = &arrays["vertices"].2;
        data.chunks_exact(12).map(<[u8]>::to_vec).collect::<HashSet<_>>()
    };
    assert!(positions(Detail::Drawn).is_subset(&positions(Detail::Authored)));
}

/// As in the frame, rocks that are too small to be labelled as rocks are regolith in what is drawn.
#[test]
fn rocks_that_a_frame_labels_regolith_are_regolith_in_its_drawn_export() {
    let subject = Subject::new(SEED, &["label.min_diameter_m=4"]);
    let classes = |detail| {
        let arrays = arrays(&subject.export(Format::Npz, detail));
        let classes = &arrays["triangle_class"].2;
        let instances = u16s(&arrays["triangle_instance"].2);
        assert!(classes.iter().zip(&instances).all(|(class, instance)| (*class == 1) == (*instance > 0)));
        instances.into_iter().filter(|instance| *instance > 0).collect::<BTreeSet<u16>>()
    };
    let (authored, drawn) = (classes(Detail::Authored), classes(Detail::Drawn));
    let scene = &subject.scene;
    let large = scene.rocks.iter().filter(|rock| rock.diameter_m() >= 4.0);
    let large: BTreeSet<u16> = large.map(|rock| rock.index as u16 + 1).collect();
    assert!(!drawn.is_empty() && drawn.is_subset(&large), "{drawn:?} of {large:?}");
    assert_eq!(authored.len(), scene.rocks.count());
}

#[test]
fn equal_scenes_give_equal_bytes_and_others_do_not() {
    let (once, again, other) = (Subject::new(SEED, &[]), Subject::new(SEED, &[]), Subject::new(12, &[]));
    for (format, name) in Format::ALL {
        for detail in [Detail::Authored, Detail::Drawn] {
            let bytes = once.export(format, detail);
            assert!(bytes == again.export(format, detail), "{name} {detail:?}");
            assert!(bytes != other.export(format, detail), "{name} {detail:?}");
        }
    }
}

/// Equal numbers, except for the last bit, which JSON may lose.
fn assert_same(actual: &[f64], recorded: &[f64]) {
    assert_eq!(actual.len(), recorded.len());
    for (a, b) in actual.iter().zip(recorded) {
        assert!((a - b).abs() <= f64::EPSILON * b.abs(), "{actual:?} {recorded:?}");
    }
}

#[test]
fn every_rock_in_a_distorted_frame_is_in_the_drawn_export() {
    let folder = folder();
    for (seed, more) in [
        ("4", &["--set", "camera.k1=-0.15", "--set", "rocks.count=400"][..]),
        ("1", &["--preset", "surface_train_full"]),
    ] {
        let words = [&["--seed", seed, "--size", "256"], more].concat();
        run_ok(folder.path(), &[&words[..], &["--outputs", "instances", "--force", "-q"]].concat());
        run_ok(folder.path(), &[&["export", "stage.npz", "--drawn", "--force"], &words[..]].concat());
        let arrays = arrays(&std::fs::read(folder.path().join("stage.npz")).expect("the file"));
        let drawn: BTreeSet<String> = arrays["triangle_instance"]
            .2
            .chunks_exact(2)
            .map(|b| u16::from_le_bytes([b[0], b[1]]).to_string())
            .collect();
        let visible = json(&folder.path().join("out/instance_segmentation_mapping_0000.json"));
        let visible = visible.as_object().expect("a mapping");
        assert!(visible.len() > 20 && visible.keys().all(|rock| drawn.contains(rock)), "{visible:?}");
    }
}

#[test]
fn the_arrays_have_the_camera_of_the_frame_record() {
    let folder = folder();
    let words =
        ["--seed", "5", "--size", "96x64", "--set", "camera.yaw_deg=20", "--set", "camera.roll_deg=5"];
    run_ok(folder.path(), &[&words[..], &["--outputs", "meta"]].concat());
    run_ok(folder.path(), &[&["export", "stage.npz"], &words[..]].concat());
    let record = &json(&folder.path().join("out/frame_0000.json"));
    let arrays = arrays(&std::fs::read(folder.path().join("stage.npz")).expect("the file"));
    for name in ["K", "world_from_camera"] {
        let rows = record["camera"][name].as_array().expect("rows");
        let recorded: Vec<f64> = rows
            .iter()
            .flat_map(|row| row.as_array().expect("a row"))
            .map(|entry| entry.as_f64().expect("a number"))
            .collect();
        assert_same(&f64s(&arrays[name].2), &recorded);
    }
    let sun: Vec<f64> = f32s(&arrays["sun_direction"].2).into_iter().map(f64::from).collect();
    let recorded: Vec<f64> = record["sun"]["direction"]
        .as_array()
        .expect("a vector")
        .iter()
        .map(|entry| entry.as_f64().expect("a number"))
        .collect();
    assert_same(&sun, &recorded);
}

/// The JSON chunk and the binary chunk of a binary glTF.
fn chunks(file: &[u8]) -> (Value, &[u8]) {
    let words = u32s(&file[..20]);
    assert_eq!((&file[..4], words[1], words[2] as usize), (&b"glTF"[..], 2, file.len()));
    let json_end = 20 + words[3] as usize;
    assert_eq!(&file[16..20], b"JSON");
    assert_eq!(&file[json_end + 4..json_end + 8], b"BIN\0");
    let binary = &file[json_end + 8..];
    assert_eq!(u32s(&file[json_end..json_end + 4])[0] as usize, binary.len());
    assert!(json_end.is_multiple_of(4) && binary.len().is_multiple_of(4));
    (serde_json::from_slice(&file[20..json_end]).expect("JSON"), binary)
}

#[test]
fn gltf_accessors_fit_their_views_and_nodes_have_their_parents_and_positions() {
    let subject = Subject::new(SEED, &[]);
    for detail in [Detail::Authored, Detail::Drawn] {
        let file = subject.export(Format::Glb, detail);
        let (root, binary) = chunks(&file);
        let number = |value: &Value| value.as_u64().expect("a number") as usize;
        // Data of an accessor, from its own count, type and view.
        let data = |accessor: &Value| {
            let view = &root["bufferViews"][number(&accessor["bufferView"])];
            let lanes = if accessor["type"] == "VEC3" { 3 } else { 1 };
            let size = if accessor["componentType"] == 5123 { 2 } else { 4 };
            assert_eq!(number(&view["byteLength"]), number(&accessor["count"]) * lanes * size);
            let start = number(&view["byteOffset"]);
            assert_eq!(start % 4, 0);
            &binary[start..start + number(&view["byteLength"])]
        };
        let nodes = root["nodes"].as_array().expect("nodes");
        let children = |name: &str| -> Vec<&str> {
            let node = nodes.iter().find(|node| node["name"] == name).expect("the node");
            let children = node["children"].as_array().expect("children");
            children.iter().map(|child| nodes[number(child)]["name"].as_str().expect("a name")).collect()
        };
        let expected = subject.expected(detail);
        let names: Vec<String> =
            expected[1..].iter().map(|(instance, ..)| format!("Rock_{:03}", instance - 1)).collect();
        assert_eq!(children("Rocks"), names);
        let world: BTreeSet<&str> = children("World").into_iter().collect();
        assert_eq!(world, BTreeSet::from(["Regolith", "RoverCam", "Rocks", "StarDome", "Stars", "Sun"]));
        for &(instance, class, triangles) in &expected {
            let name =
                instance.checked_sub(1).map_or("Regolith".to_owned(), |rock| format!("Rock_{rock:03}"));
            let node = nodes.iter().find(|node| node["name"] == name.as_str()).expect("its node");
            let class = class.class().expect("known");
            let extras =
                serde_json::json!({"class": class.name, "class_id": class.id.0, "instance_id": instance});
            assert_eq!(node["extras"], extras);
            let primitive = &root["meshes"][number(&node["mesh"])]["primitives"][0];
            let positions = &root["accessors"][number(&primitive["attributes"]["POSITION"])];
            let indices = &root["accessors"][number(&primitive["indices"])];
            assert_eq!(number(&indices["count"]), 3 * triangles);
            let count = number(&positions["count"]);
            let largest = if indices["componentType"] == 5123 {
                assert!(count <= 65_535);
                u16s(data(indices)).into_iter().max().map(usize::from)
            } else {
                assert!(count > 65_535, "{name} has short indices' worth of vertices");
                u32s(data(indices)).into_iter().max().map(|v| v as usize)
            };
            assert_eq!(largest, Some(count - 1));
            let points = f32s(data(positions));
            for axis in 0..3 {
                let along = || points.iter().skip(axis).step_by(3).copied();
                assert_eq!(positions["min"][axis], along().fold(f32::MAX, f32::min));
                assert_eq!(positions["max"][axis], along().fold(f32::MIN, f32::max));
            }
            let material = &root["materials"][number(&primitive["material"])];
            let (centre, albedo) = match instance.checked_sub(1) {
                Some(rock) => {
                    let rock = &subject.scene.rocks[usize::from(rock)];
                    (rock.centre, rock.material.albedo)
                }
                None => (glam::Vec3::ZERO, subject.scene.regolith.albedo),
            };
            for axis in 0..3 {
                assert_eq!(node["translation"][axis], centre[axis]);
                assert_eq!(material["pbrMetallicRoughness"]["baseColorFactor"][axis], albedo[axis]);
            }
        }
        let pool: HashSet<[u32; 4]> = expected[1..]
            .iter()
            .map(|(instance, ..)| subject.scene.rocks[usize::from(*instance) - 1].material)
            .map(|m| m.albedo.extend(m.roughness).to_array().map(f32::to_bits))
            .collect();
        // And the materials of the ground, the dome and the stars.
        assert_eq!(root["materials"].as_array().map(Vec::len), Some(pool.len() + 3));
        assert_eq!(root["asset"]["extras"]["knobs"]["sun.azimuth_deg"], subject.knobs["sun.azimuth_deg"]);
    }
}

/// Path and type of every prim, from the nesting of `def` and braces.
fn prims(text: &str) -> BTreeMap<String, String> {
    let (mut prims, mut path, mut depth) = (BTreeMap::new(), Vec::<(usize, String)>::new(), 0);
    for line in text.lines().map(str::trim) {
        if let Some(rest) = line.strip_prefix("def ") {
            let (kind, rest) = rest.split_once(" \"").expect("a type and a name");
            path.retain(|(at, _)| *at < depth);
            path.push((depth, rest.split_once('"').expect("a closed name").0.to_owned()));
            let names: Vec<&str> = path.iter().map(|(_, name)| name.as_str()).collect();
            let fresh = prims.insert(format!("/{}", names.join("/")), kind.to_owned()).is_none();
            assert!(fresh, "twice: {line}");
        }
        match line {
            "{" => depth += 1,
            "}" => depth -= 1,
            _ if line.ends_with("= {") => depth += 1,
            _ => {}
        }
    }
    assert_eq!(depth, 0, "balanced");
    prims
}

/// The numbers of the value of `name`, on its line.
fn numbers(text: &str, name: &str) -> Vec<f64> {
    let line = text.lines().find(|line| line.contains(name)).unwrap_or_else(|| panic!("no {name}"));
    line.split_once('=')
        .expect("a value")
        .1
        .split(|c: char| "()[], ".contains(c))
        .filter(|word| !word.is_empty())
        .map(|word| word.parse().unwrap_or_else(|_| panic!("{line}")))
        .collect()
}

/// The text from the definition of a prim to the end.
fn from_prim<'a>(text: &'a str, name: &str) -> &'a str {
    text.split_once(&format!("\"{name}\"")).unwrap_or_else(|| panic!("no {name}")).1
}

#[test]
fn usd_has_the_prims_of_the_reference_stage() {
    let subject = Subject::new(SEED, &[]);
    for detail in [Detail::Authored, Detail::Drawn] {
        let text = String::from_utf8(subject.export(Format::Usda, detail)).expect("text");
        let prims = prims(&text);
        for (path, kind) in [
            ("/World", "Xform"),
            ("/World/Regolith", "Mesh"),
            ("/World/Rocks", "Xform"),
            ("/World/Sun", "DistantLight"),
            ("/World/StarDome", "Mesh"),
            ("/World/Stars", "Xform"),
            ("/World/RoverCam", "Camera"),
            ("/World/Looks", "Scope"),
        ] {
            assert_eq!(prims.get(path).map(String::as_str), Some(kind), "{path}");
        }
        let rocks: Vec<&str> =
            prims.keys().filter_map(|path| path.strip_prefix("/World/Rocks/Rock_")).collect();
        let expected = subject.expected(detail);
        let indices: Vec<String> =
            expected[1..].iter().map(|(instance, ..)| format!("{:03}", instance - 1)).collect();
        assert_eq!(rocks, indices);
        for &(instance, class, triangles) in &expected {
            let name =
                instance.checked_sub(1).map_or("Regolith".to_owned(), |rock| format!("Rock_{rock:03}"));
            let prim = from_prim(&text, &name);
            assert_eq!(numbers(prim, "faceVertexCounts").len(), triangles, "{name}");
            let label = class.class().expect("known").name;
            let line = prim.lines().find(|line| line.contains("semantics:labels:class")).expect("a label");
            assert!(line.contains(&format!("[\"{label}\"]")), "{name}: {line}");
        }
        // Every bound material exists.
        for line in text.lines().filter(|line| line.contains("rel material:binding")) {
            let path = line.split_once('<').and_then(|(_, rest)| rest.split_once('>')).expect("a path").0;
            assert_eq!(prims.get(path).map(String::as_str), Some("Material"), "{path}");
        }
    }
}

#[test]
fn usd_sky_leaves_a_hole_around_a_sun_in_front() {
    // In front and high, where the stars are.
    let subject = Subject::new(SEED, &["sun.azimuth_deg=0", "sun.elevation_deg=40"]);
    let (sky, sun) = (&subject.scene.sky, subject.scene.sun.direction.as_dvec3());
    let text = String::from_utf8(subject.export(Format::Usda, Detail::Drawn)).expect("text");
    let cos = |towards: glam::DVec3| towards.normalize().dot(sun);
    let edge = 34.0_f64.to_radians().cos();
    let dome = from_prim(&text, "StarDome");
    let points: Vec<glam::DVec3> = numbers(dome, "point3f[] points")
        .chunks_exact(3)
        .map(|p| glam::DVec3::from_slice(p) - sky.centre.as_dvec3())
        .collect();
    let corners = numbers(dome, "int[] faceVertexIndices");
    assert!(points.iter().all(|p| (p.length() - f64::from(sky.radius_m)).abs() < 1e-2));
    assert!(points.iter().all(|p| cos(*p) <= edge + 1e-6), "a corner in the hole");
    // Only the cone is missing, and at most one more ring of triangles.
    assert!(points.iter().any(|p| cos(*p) > 38.0_f64.to_radians().cos()));
    assert!(corners.len() > 3 * 4000);
    for triangle in corners.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|i| points[triangle[i] as usize]);
        assert!((b - a).cross(c - a).dot(a) < 0.0, "faces the inside");
    }
    let prims = prims(&text);
    let (mut inside, mut outside) = (Vec::new(), 0);
    for (index, star) in sky.stars.iter().enumerate() {
        let is_inside = cos((star.centre - sky.centre).as_dvec3()) > edge;
        assert_eq!(prims.contains_key(&format!("/World/Stars/Star_{index:03}")), !is_inside, "star {index}");
        if is_inside { inside.push(index as f64) } else { outside += 1 }
    }
    assert!(!inside.is_empty() && outside > 0, "{} stars in the hole", inside.len());
    assert_eq!(numbers(&text, "int[] starsLeftOutInHole"), inside, "the file lists them");
}

#[test]
fn usd_light_and_camera_are_those_of_the_scene() {
    let mut subject =
        Subject::new(SEED, &["sun.intensity=9000", "sun.color=[1.0, 0.5, 0.25]", "camera.roll_deg=7"]);
    for knobs_known in [true, false] {
        if !knobs_known {
            subject.knobs.clear();
        }
        let text = String::from_utf8(subject.export(Format::Usda, Detail::Drawn)).expect("text");
        let sun = from_prim(&text, "Sun");
        let matrix = numbers(sun, "xformOp:transform =");
        for axis in 0..3 {
            let shines = -matrix[8 + axis];
            assert!((shines + f64::from(subject.scene.sun.direction[axis])).abs() < 1e-6);
        }
        let colour = numbers(sun, "inputs:color");
        let intensity = numbers(sun, "inputs:intensity")[0];
        for (channel, expected) in colour.iter().zip([1.0, 0.5, 0.25]) {
            assert!((channel - expected).abs() < 1e-6, "{colour:?}");
        }
        assert!((intensity - 9000.0).abs() < 0.01, "{intensity}");
        assert_eq!(numbers(sun, "inputs:angle"), [subject.scene.sun.angular_diameter_deg]);
        let lens = from_prim(&text, "RoverCam");
        let [across, down] = ["horizontalAperture", "verticalAperture"].map(|name| numbers(lens, name)[0]);
        let k = subject.scene.camera.intrinsics(SIZE);
        let focal_px = numbers(lens, "focalLength")[0] / across * f64::from(SIZE[0]);
        assert!((focal_px - k[0][0]).abs() < 1e-3, "{focal_px} {}", k[0][0]);
        assert_eq!((across, down), (24.0, 12.0));
        // USD's rows are the columns of the pose with OpenGL's axes.
        let (rows, pose) =
            (numbers(lens, "xformOp:transform ="), subject.scene.camera.world_from_camera_gl());
        for (i, row) in pose.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                assert!((rows[4 * j + i] - entry).abs() < 1e-4, "{rows:?} {pose:?}");
            }
        }
    }
}
