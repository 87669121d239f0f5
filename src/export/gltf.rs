//! The scene as binary glTF 2.0: a node a rock, with class and instance as extras.
//!
//! glTF is Y-up: the root node `World` turns the scene's Z up.
//! Must not know: how its numbers came about.

use glam::Vec3;
use serde_json::{Value, json};

use super::sky::{HOLE_DEG, Sky};
use super::{Stage, looks};
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::sky::STAR_LEVEL;

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

    /// A mesh.
    fn mesh(&mut self, name: &str, vertices: &[Vertex], triangles: &[[u32; 3]], material: usize) -> Value {
        let positions: Vec<[f32; 3]> = vertices.iter().map(|v| v.position.to_array()).collect();
        let normals: Vec<[f32; 3]> = vertices.iter().map(|v| v.normal.to_array()).collect();
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
            |kind: u32| json!({ "componentType": kind, "count": 3 * triangles.len(), "type": "SCALAR" });
        let corners = triangles.as_flattened();
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
        meshes.push(buffer.mesh(&name, part.vertices, &part.triangles, look));
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
    let mut materials: Vec<Value> = looks
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
    let sky = Sky::of(scene);
    let sphere = Icosphere::shared();
    let inwards = sky.directions.iter().map(|&d| Vertex { position: scene.sky.radius_m * d, normal: -d });
    let unit = &sphere.directions[..Icosphere::vertex_count(STAR_LEVEL)];
    let unit: Vec<Vertex> = unit.iter().map(|&d| Vertex { position: d, normal: d }).collect();
    let dome_mesh = meshes.len();
    meshes.push(buffer.mesh("StarDome", &inwards.collect::<Vec<_>>(), &sky.triangles, materials.len()));
    meshes.push(buffer.mesh("Star", &unit, &sphere.triangles[STAR_LEVEL], materials.len() + 1));
    materials.push(emitter("StarDome", scene.sky.radiance));
    materials.push(emitter("Star", scene.sky.star_radiance));
    let of_sky = json!({ "class": ClassId::SKY.class().map(|class| class.name), "class_id": ClassId::SKY.0 });
    world.extend([4 + things.len(), 5 + things.len()]);
    let first_star = 6 + things.len();
    let stars: Vec<usize> = (first_star..first_star + sky.stars.len()).collect();
    things.push(json!({
        "name": "StarDome", "mesh": dome_mesh, "translation": scene.sky.centre.to_array(), "extras": of_sky,
    }));
    things.push(json!({
        "name": "Stars",
        "children": stars,
        "extras": { "hole_half_angle_deg": HOLE_DEG, "stars_left_out_in_hole": sky.left_out },
    }));
    things.extend(sky.stars.iter().map(|(index, star)| {
        json!({
            "name": format!("Star_{index:03}"),
            "mesh": dome_mesh + 1,
            "translation": star.centre.to_array(),
            "scale": Vec3::splat(star.radius_m).to_array(),
            "extras": of_sky,
        })
    }));
    let camera = &scene.camera;
    // Columns of a matrix: where the node's axes point (glTF looks along -Z with Y up), and its place.
    let matrix = |x: Vec3, y: Vec3, z: Vec3, place: Vec3| {
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
            "matrix": matrix(across, up, scene.sun.direction, Vec3::ZERO),
            "extensions": { "KHR_lights_punctual": { "light": 0 } },
        }),
    ];
    nodes.extend(things);
    for node in nodes.iter_mut().filter_map(Value::as_object_mut) {
        // glTF forbids an empty list of children.
        if node.get("children").and_then(Value::as_array).is_some_and(Vec::is_empty) {
            node.remove("children");
        }
    }
    let root = json!({
        "asset": {
            "version": "2.0",
            "generator": format!("regolith-render {}", env!("CARGO_PKG_VERSION")),
            "extras": { "seed": stage.seed, "knobs": stage.knobs },
        },
        "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_specular"],
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

/// A material that reflects nothing and has light of its own.
fn emitter(name: &str, radiance: Vec3) -> Value {
    // A colour ends at 1 there; what is brighter has a strength.
    let strength = radiance.max_element().max(1.0);
    json!({
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.0, 0.0, 0.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0,
        },
        "emissiveFactor": (radiance / strength).to_array(),
        "extensions": {
            "KHR_materials_emissive_strength": { "emissiveStrength": strength },
            "KHR_materials_specular": { "specularFactor": 0.0 },
        },
    })
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
        let stars = nodes.iter().filter(|n| n["name"].as_str().is_some_and(|name| name.starts_with("Star_")));
        let stars = stars.inspect(|star| assert_eq!(star["extras"], json!({"class": "sky", "class_id": 2})));
        let (stars, listed) = (stars.count(), &nodes[6 + scene.rocks.len()]);
        assert!(stars > 150 && stars <= 220, "{stars} stars outside the hole");
        assert_eq!(
            (&listed["name"], listed["children"].as_array().map(Vec::len)),
            (&"Stars".into(), Some(stars))
        );
        assert_eq!(nodes.len(), 7 + scene.rocks.len() + stars);
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
