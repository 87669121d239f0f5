//! The scene as binary glTF 2.0 (`.glb`): one node per rock, with class and instance as extras.
//!
//! glTF is Y-up, so the root node `World` rotates the scene's Z up to Y.
//! Must not know: how the scene is made.

use glam::Vec3;
use serde_json::{Value, json};

use super::sky::{HOLE_DEG, Sky};
use super::stage::{PartKind, ROVER_LABEL, Stage, materials};
use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::mesh::{Icosphere, Vertex};
use crate::scene::rocks::Material;
use crate::scene::sky::{STAR_LEVEL, Sun};

/// Bytes of the file header and of the headers of two chunks.
const GLB_HEADERS_BYTES: usize = 28;

// Component types of accessors and targets of buffer views.
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The binary chunk with its buffer views and accessors.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds data with a buffer view of their own, and returns the index of their accessor.
    fn add(&mut self, data: &[u8], target: u32, mut accessor: Value) -> usize {
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": data.len(), "target": target,
        }));
        self.bytes.extend_from_slice(data);
        // An accessor must start at a multiple of its component size: four suits every component type.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds vertices and indices, and returns the mesh that uses them.
    fn mesh(&mut self, name: &str, vertices: &[Vertex], triangles: &[[u32; 3]], material: usize) -> Value {
        let positions: Vec<[f32; 3]> = vertices.iter().map(|v| v.position.to_array()).collect();
        let normals: Vec<[f32; 3]> = vertices.iter().map(|v| v.normal.to_array()).collect();
        let bound = |start: f32, pick: fn(f32, f32) -> f32| {
            positions.iter().fold([start; 3], |bound, p| std::array::from_fn(|i| pick(bound[i], p[i])))
        };
        let vec3_accessor = |more: Value| {
            let mut accessor = json!({ "componentType": FLOAT, "count": positions.len(), "type": "VEC3" });
            if let (Some(accessor), Value::Object(more)) = (accessor.as_object_mut(), more) {
                accessor.extend(more);
            }
            accessor
        };
        let bounds = json!({ "min": bound(f32::MAX, f32::min), "max": bound(f32::MIN, f32::max) });
        let position = self.add(bytemuck::cast_slice(&positions), ARRAY_BUFFER, vec3_accessor(bounds));
        let normal = self.add(bytemuck::cast_slice(&normals), ARRAY_BUFFER, vec3_accessor(json!({})));
        let index_accessor = |component_type: u32| json!({ "componentType": component_type, "count": 3 * triangles.len(), "type": "SCALAR" });
        let vertex_indices = triangles.as_flattened();
        // glTF reserves the largest value of an index type for primitive restart.
        let indices = if positions.len() <= usize::from(u16::MAX) {
            let short: Vec<u16> = vertex_indices.iter().map(|&v| v as u16).collect();
            self.add(bytemuck::cast_slice(&short), ELEMENT_ARRAY_BUFFER, index_accessor(UNSIGNED_SHORT))
        } else {
            self.add(bytemuck::cast_slice(vertex_indices), ELEMENT_ARRAY_BUFFER, index_accessor(UNSIGNED_INT))
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

// Fixed nodes; ground, rocks and sky follow.
const ROCKS_NODE: usize = 1;
const CAMERA_NODE: usize = 2;
const SUN_NODE: usize = 3;
const FIXED_NODES: usize = 4;

/// Encodes a stage as `.glb`.
pub(super) fn encode(stage: &Stage<'_>) -> Result<Vec<u8>> {
    let mut document =
        Document { world_children: vec![ROCKS_NODE, CAMERA_NODE, SUN_NODE], ..Document::default() };
    document.add_parts(stage)?;
    document.add_sky(stage.scene);
    let (root, binary) = document.finish(stage);
    glb(&root, binary)
}

/// The arrays of the glTF document as they grow.
#[derive(Default)]
struct Document {
    buffer: Buffer,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    /// The nodes after the fixed ones.
    nodes: Vec<Value>,
    world_children: Vec<usize>,
    rocks_children: Vec<usize>,
    rover_children: Vec<usize>,
}

impl Document {
    /// Index of the node that is added next.
    const fn next_node(&self) -> usize {
        FIXED_NODES + self.nodes.len()
    }

    /// Adds a node, a mesh and, unless known, a material for the ground and each rock.
    fn add_parts(&mut self, stage: &Stage<'_>) -> Result<()> {
        let parts = stage.parts()?;
        let (materials, material_of) = materials(&parts);
        for (part, material) in parts.iter().zip(material_of) {
            let node = self.next_node();
            let siblings = match part.kind {
                PartKind::Ground => &mut self.world_children,
                PartKind::Rock(_) => &mut self.rocks_children,
                PartKind::Rover(_) => &mut self.rover_children,
            };
            siblings.push(node);
            let name = part.name();
            self.meshes.push(self.buffer.mesh(&name, part.vertices, &part.triangles, material));
            self.nodes.push(json!({
                "name": name,
                "mesh": self.meshes.len() - 1,
                "translation": part.origin.to_array(),
                "extras": {
                    "class": part.class.class().map_or(ROVER_LABEL, |class| class.name),
                    "class_id": part.class.0,
                    "instance_id": part.instance,
                },
            }));
        }
        if !self.rover_children.is_empty() {
            self.world_children.push(self.next_node());
            self.nodes.push(json!({ "name": "Rover", "children": self.rover_children }));
        }
        self.materials.extend(materials.iter().map(|(name, material)| surface(name, *material)));
        Ok(())
    }

    /// Adds the dome and the stars. All stars share one mesh.
    fn add_sky(&mut self, scene: &Scene) {
        let sky = Sky::of(scene);
        let sphere = Icosphere::shared();
        let inwards = sky.directions.iter().map(|&d| Vertex { position: scene.sky.radius_m * d, normal: -d });
        let unit = &sphere.directions[..Icosphere::vertex_count(STAR_LEVEL)];
        let unit: Vec<Vertex> = unit.iter().map(|&d| Vertex { position: d, normal: d }).collect();
        let (dome_mesh, star_mesh) = (self.meshes.len(), self.meshes.len() + 1);
        let (dome_material, star_material) = (self.materials.len(), self.materials.len() + 1);
        let dome = self.buffer.mesh("StarDome", &inwards.collect::<Vec<_>>(), &sky.triangles, dome_material);
        let star = self.buffer.mesh("Star", &unit, &sphere.triangles[STAR_LEVEL], star_material);
        self.meshes.extend([dome, star]);
        self.materials
            .extend([emitter("StarDome", scene.sky.radiance), emitter("Star", scene.sky.star_radiance)]);
        let label =
            json!({ "class": ClassId::SKY.class().map(|class| class.name), "class_id": ClassId::SKY.0 });
        let (dome_node, stars_node) = (self.next_node(), self.next_node() + 1);
        self.world_children.extend([dome_node, stars_node]);
        let children: Vec<usize> = (stars_node + 1..).take(sky.stars.len()).collect();
        self.nodes.push(json!({
            "name": "StarDome", "mesh": dome_mesh, "translation": scene.sky.centre.to_array(), "extras": label,
        }));
        self.nodes.push(json!({
            "name": "Stars",
            "children": children,
            "extras": { "hole_half_angle_deg": HOLE_DEG, "stars_left_out_in_hole": sky.left_out },
        }));
        self.nodes.extend(sky.stars.iter().map(|(index, star)| {
            json!({
                "name": format!("Star_{index:03}"),
                "mesh": star_mesh,
                "translation": star.centre.to_array(),
                "scale": Vec3::splat(star.radius_m).to_array(),
                "extras": label,
            })
        }));
    }

    /// The JSON chunk and the binary chunk.
    fn finish(self, stage: &Stage<'_>) -> (Value, Vec<u8>) {
        let mut nodes = fixed_nodes(stage.scene, &self.world_children, &self.rocks_children);
        nodes.extend(self.nodes);
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
            "extensions": { "KHR_lights_punctual": { "lights": [directional_light(&stage.scene.sun)] } },
            "scene": 0,
            "scenes": [{ "name": "Lunar stage", "nodes": [0] }],
            "nodes": nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "cameras": [perspective_camera(&stage.scene.camera, stage.settings.size)],
            "accessors": self.buffer.accessors,
            "bufferViews": self.buffer.views,
            "buffers": [{ "byteLength": self.buffer.bytes.len() }],
        });
        (root, self.buffer.bytes)
    }
}

/// World, rocks, camera and sun. glTF cameras and lights look along -Z with Y up.
fn fixed_nodes(scene: &Scene, world_children: &[usize], rocks_children: &[usize]) -> Vec<Value> {
    // The columns of a node's matrix are its axes and its position.
    let matrix = |x: Vec3, y: Vec3, z: Vec3, position: Vec3| {
        let columns = [x.extend(0.0), y.extend(0.0), z.extend(0.0), position.extend(1.0)];
        json!(columns.map(|column| column.to_array()).as_flattened())
    };
    let camera = &scene.camera;
    let [right, up] = scene.sun.right_and_up();
    // A quaternion that rotates by -90 degrees about X.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    vec![
        json!({ "name": "World", "rotation": [-half, 0.0, 0.0, half], "children": world_children }),
        json!({ "name": "Rocks", "children": rocks_children }),
        json!({
            "name": "RoverCam",
            "camera": 0,
            "matrix": matrix(camera.right, camera.up, -camera.forward, camera.eye),
        }),
        json!({
            "name": "Sun",
            "matrix": matrix(right, up, scene.sun.direction, Vec3::ZERO),
            "extensions": { "KHR_lights_punctual": { "light": 0 } },
        }),
    ]
}

fn directional_light(sun: &Sun) -> Value {
    let brightest = sun.irradiance.max_element();
    json!({
        "type": "directional",
        "name": "Sun",
        "color": (sun.irradiance / brightest.max(f32::MIN_POSITIVE)).to_array(),
        "intensity": brightest,
    })
}

fn perspective_camera(camera: &Camera, [width, height]: [u32; 2]) -> Value {
    let aspect = f64::from(width) / f64::from(height);
    json!({
        "name": "RoverCam",
        "type": "perspective",
        "perspective": {
            "yfov": 2.0 * libm::atan(f64::from(camera.tan_half_fov) / aspect),
            "aspectRatio": aspect,
            "znear": camera.near_m,
            "zfar": camera.far_m,
        },
    })
}

/// A GLB container: a header, the JSON chunk and the binary chunk, each padded to a multiple of four bytes.
fn glb(root: &Value, mut binary: Vec<u8>) -> Result<Vec<u8>> {
    let failed = |message: String| Error::Encode { name: "the .glb file".to_owned(), message };
    let mut text = serde_json::to_vec(root).map_err(|error| failed(error.to_string()))?;
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = u32::try_from(GLB_HEADERS_BYTES + text.len() + binary.len()).map_err(|_| {
        failed(format!(
            "{} bytes, and the format holds at most 4 GiB; export to .usdc or .npz",
            GLB_HEADERS_BYTES + text.len() + binary.len()
        ))
    })?;
    let mut file = Vec::with_capacity(total as usize);
    file.extend(b"glTF");
    file.extend([2, total].map(u32::to_le_bytes).as_flattened());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &binary)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    Ok(file)
}

/// A rough dielectric surface. A base colour has channels of at most 1; a brighter one of an extreme albedo is clamped.
fn surface(name: &str, material: Material) -> Value {
    json!({
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": material.albedo.min(Vec3::ONE).extend(1.0).to_array(),
            "metallicFactor": 0.0,
            "roughnessFactor": material.roughness,
        },
    })
}

/// A material that reflects nothing and emits light.
fn emitter(name: &str, radiance: Vec3) -> Value {
    // An emissive factor is at most 1; brighter light has an emissive strength.
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
    fn base_colours_are_at_most_one() {
        let material = Material { albedo: Vec3::new(2.0, 1.0, 0.5), roughness: 0.75 };
        let made = surface("Regolith", material);
        assert_eq!(made["pbrMetallicRoughness"]["baseColorFactor"], json!([1.0, 1.0, 0.5, 1.0]));
    }

    #[test]
    fn chunks_nodes_and_accessors_match_the_scene() {
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
