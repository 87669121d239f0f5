//! The scene as binary glTF 2.0: a node a rock, with class and instance as extras.
//!
//! glTF is Y-up: the root node `World` turns the scene's Z up.
//! Must not know: a sky, which viewers of glTF have one of their own for.

use serde_json::{Value, json};

use super::{Part, Stage, looks};
use crate::error::{Error, Result};

/// Component types and buffer targets of glTF.
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The binary chunk as it grows, with the views and accessors into it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds data and gives the index of their accessor.
    fn add(&mut self, data: &[u8], target: u32, mut accessor: Value) -> usize {
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": data.len(), "target": target,
        }));
        self.bytes.extend_from_slice(data);
        // Every view starts at a multiple of four, whatever the component type.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// The mesh of a part.
    fn mesh(&mut self, part: &Part<'_>, name: &str, material: usize) -> Value {
        let positions: Vec<[f32; 3]> = part.vertices.iter().map(|v| v.position.to_array()).collect();
        let normals: Vec<[f32; 3]> = part.vertices.iter().map(|v| v.normal.to_array()).collect();
        let bound = |start: f32, pick: fn(f32, f32) -> f32| {
            positions.iter().fold([start; 3], |bound, p| std::array::from_fn(|i| pick(bound[i], p[i])))
        };
        let vectors = |more: Value| {
            let mut accessor = json!({ "componentType": FLOAT, "count": positions.len(), "type": "VEC3" });
            if let (Some(accessor), Value::Object(more)) = (accessor.as_object_mut(), more) {
                accessor.extend(more);
            }
            accessor
        };
        let bounds = json!({ "min": bound(f32::MAX, f32::min), "max": bound(f32::MIN, f32::max) });
        let position = self.add(bytemuck::cast_slice(&positions), ARRAY_BUFFER, vectors(bounds));
        let normal = self.add(bytemuck::cast_slice(&normals), ARRAY_BUFFER, vectors(json!({})));
        let scalars =
            |kind: u32| json!({ "componentType": kind, "count": 3 * part.triangles.len(), "type": "SCALAR" });
        let corners = part.triangles.as_flattened();
        // The largest number of a type is not an index in glTF.
        let indices = if positions.len() <= usize::from(u16::MAX) {
            let short: Vec<u16> = corners.iter().map(|&v| v as u16).collect();
            self.add(bytemuck::cast_slice(&short), ELEMENT_ARRAY_BUFFER, scalars(UNSIGNED_SHORT))
        } else {
            self.add(bytemuck::cast_slice(corners), ELEMENT_ARRAY_BUFFER, scalars(UNSIGNED_INT))
        };
        json!({
            "name": name,
            "primitives": [{
                "attributes": { "POSITION": position, "NORMAL": normal },
                "indices": indices,
                "material": material,
            }],
        })
    }
}

pub(super) fn encode(stage: &Stage<'_>) -> Result<Vec<u8>> {
    let scene = stage.scene;
    let mut buffer = Buffer::default();
    let mut meshes = Vec::new();
    // Node 0 is World, 1 Rocks, 2 the camera, 3 the sun; ground and rocks follow.
    let (mut world, mut rocks, mut things) = (vec![1, 2, 3], Vec::new(), Vec::new());
    let parts = stage.parts()?;
    let (looks, look_of) = looks(&parts);
    for (part, look) in parts.iter().zip(look_of) {
        let children = if part.rock.is_some() { &mut rocks } else { &mut world };
        children.push(4 + things.len());
        let name = part.name();
        meshes.push(buffer.mesh(part, &name, look));
        things.push(json!({
            "name": name,
            "mesh": meshes.len() - 1,
            "translation": part.origin.to_array(),
            "extras": {
                "class": part.class.class().map(|class| class.name),
                "class_id": part.class.0,
                "instance_id": part.instance,
            },
        }));
    }
    let materials: Vec<Value> = looks
        .iter()
        .map(|(name, material)| {
            json!({
                "name": name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": material.albedo.extend(1.0).to_array(),
                    "metallicFactor": 0.0,
                    "roughnessFactor": material.roughness,
                },
            })
        })
        .collect();
    let camera = &scene.camera;
    // Columns of a matrix: where the node's axes point (glTF looks along -Z with Y up), and its place.
    let matrix = |x: glam::Vec3, y: glam::Vec3, z: glam::Vec3, place: glam::Vec3| {
        let columns = [x.extend(0.0), y.extend(0.0), z.extend(0.0), place.extend(1.0)];
        json!(columns.map(|column| column.to_array()).as_flattened())
    };
    let [across, up] = scene.sun.right_and_up();
    let [width, height] = stage.settings.size;
    let aspect = f64::from(width) / f64::from(height);
    let turn = std::f64::consts::FRAC_1_SQRT_2;
    let mut nodes = vec![
        json!({ "name": "World", "rotation": [-turn, 0.0, 0.0, turn], "children": world }),
        json!({ "name": "Rocks", "children": rocks }),
        json!({
            "name": "RoverCam",
            "camera": 0,
            "matrix": matrix(camera.right, camera.up, -camera.forward, camera.eye),
        }),
        json!({
            "name": "Sun",
            "matrix": matrix(across, up, scene.sun.direction, glam::Vec3::ZERO),
            "extensions": { "KHR_lights_punctual": { "light": 0 } },
        }),
    ];
    if rocks_are_none(&nodes) {
        nodes[1] = json!({ "name": "Rocks" });
    }
    nodes.extend(things);
    let root = json!({
        "asset": {
            "version": "2.0",
            "generator": format!("regolith-render {}", env!("CARGO_PKG_VERSION")),
            "extras": { "seed": stage.seed, "knobs": stage.knobs },
        },
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": { "KHR_lights_punctual": { "lights": [{
            "type": "directional",
            "name": "Sun",
            "color": (scene.sun.irradiance / scene.sun.irradiance.max_element().max(f32::MIN_POSITIVE)).to_array(),
            "intensity": scene.sun.irradiance.max_element(),
        }] } },
        "scene": 0,
        "scenes": [{ "name": "Lunar stage", "nodes": [0] }],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "cameras": [{
            "name": "RoverCam",
            "type": "perspective",
            "perspective": {
                "yfov": 2.0 * libm::atan(f64::from(camera.tan_half_fov) / aspect),
                "aspectRatio": aspect,
                "znear": camera.near_m,
                "zfar": camera.far_m,
            },
        }],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{ "byteLength": buffer.bytes.len() }],
    });
    let failed = |message: String| Error::Encode { name: "the .glb file".to_owned(), message };
    let mut text = serde_json::to_vec(&root).map_err(|error| failed(error.to_string()))?;
    text.resize(text.len().next_multiple_of(4), b' ');
    buffer.bytes.resize(buffer.bytes.len().next_multiple_of(4), 0);
    let total = u32::try_from(28 + text.len() + buffer.bytes.len())
        .map_err(|_| failed("more than 4 GiB, which the format cannot hold".to_owned()))?;
    let mut file = Vec::with_capacity(total as usize);
    file.extend(b"glTF");
    file.extend([2, total].map(u32::to_le_bytes).as_flattened());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &buffer.bytes)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    Ok(file)
}

/// glTF forbids an empty list of children.
fn rocks_are_none(nodes: &[Value]) -> bool {
    nodes[1]["children"].as_array().is_some_and(Vec::is_empty)
}

#[cfg(test)]
mod tests {
    use super::super::{Detail, Format, export};
    use super::*;
    use crate::params::Params;
    use crate::render::RenderSettings;
    use crate::scene::Scene;

    #[test]
    fn chunks_nodes_and_accessors_are_those_of_the_scene() {
        let params = Params::draw_default(7);
        let scene = Scene::build(7, &params).expect("a scene");
        let settings = RenderSettings::new([256, 128], 4).expect("settings");
        let knobs = params.to_json();
        let stage =
            Stage { scene: &scene, seed: 7, knobs: &knobs, settings: &settings, detail: Detail::Authored };
        let file = export(&stage, Format::Glb).expect("exported");
        let word =
            |at: usize| u32::from_le_bytes([file[at], file[at + 1], file[at + 2], file[at + 3]]) as usize;
        assert!(file.starts_with(b"glTF") && word(4) == 2 && word(8) == file.len());
        assert_eq!(&file[16..20], b"JSON");
        let json_end = 20 + word(12);
        assert_eq!(&file[json_end + 4..json_end + 8], b"BIN\0");
        let binary = &file[json_end + 8..];
        assert_eq!(binary.len(), word(json_end));
        let root: Value = serde_json::from_slice(&file[20..json_end]).expect("JSON");
        let nodes = root["nodes"].as_array().expect("nodes");
        assert_eq!(nodes.len(), 5 + scene.rocks.len());
        assert_eq!(root["asset"]["extras"]["seed"], 7);
        for rock in &scene.rocks {
            let name = format!("Rock_{:03}", rock.index);
            let node = nodes.iter().find(|node| node["name"] == name.as_str()).expect("a node a rock");
            assert_eq!(
                node["extras"],
                json!({"class": "rock", "class_id": 1, "instance_id": rock.index + 1})
            );
            let primitive = &root["meshes"][node["mesh"].as_u64().expect("a mesh") as usize]["primitives"][0];
            let accessor = |index: &Value| &root["accessors"][index.as_u64().expect("an accessor") as usize];
            let position = accessor(&primitive["attributes"]["POSITION"]);
            assert_eq!(position["count"], rock.vertices.len());
            assert_eq!(accessor(&primitive["indices"])["count"], 3 * rock.triangles(rock.level).len());
            let view = &root["bufferViews"][position["bufferView"].as_u64().expect("a view") as usize];
            let at = view["byteOffset"].as_u64().expect("an offset") as usize;
            assert_eq!(binary[at..at + 12], *bytemuck::bytes_of(&rock.vertices[0].position));
        }
        for view in root["bufferViews"].as_array().expect("views") {
            let end =
                view["byteOffset"].as_u64().expect("offset") + view["byteLength"].as_u64().expect("length");
            assert!(end as usize <= binary.len());
        }
    }
}
