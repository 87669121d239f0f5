//! The scene as an OpenUSD stage, with the prim names and semantic labels of the reference stage.
//!
//! Dome and stars are meshes, because other programs do not have this renderer's sky. The dome has a hole around the
//! sun, and the stars in it are left out, so that a path tracer's shadow rays reach the sun; the indices of these stars
//! are in the custom data of `/World/Stars`.
//! Must not know: which triangles a frame draws ([`Stage::parts`] does), file formats (`layer`, and its writers `text` and
//! `crate_file`).

mod crate_file;
mod layer;
mod text;

use glam::Vec3;

use super::sky::{HOLE_DEG, Sky};
use super::stage::{Part, PartKind, ROVER_LABEL, Stage, materials};
use crate::class::ClassId;
use crate::error::Result;
use crate::scene::mesh::Icosphere;
use crate::scene::rocks::Material;
use crate::scene::sky::{STAR_LEVEL, SUN_IRRADIANCE_PER_INTENSITY};
use layer::{Layer, Prim, Property, Value};

/// Horizontal aperture of the camera, millimetres.
const APERTURE_MM: f64 = 24.0;

/// Encodes a stage as text (`.usda`).
pub(super) fn encode_text(stage: &Stage<'_>) -> Result<Vec<u8>> {
    Ok(text::encode(&layer(stage)?))
}

/// Encodes a stage as a crate file (`.usdc`).
pub(super) fn encode_crate(stage: &Stage<'_>) -> Result<Vec<u8>> {
    Ok(crate_file::encode(&layer(stage)?))
}

/// The root layer.
fn layer(stage: &Stage<'_>) -> Result<Layer> {
    let parts = stage.parts()?;
    let (materials, material_of) = materials(&parts);
    let mut world = Prim::new("World", "Xform");
    let mut rocks = Prim::new("Rocks", "Xform");
    let mut rover = Prim::new("Rover", "Xform");
    for (part, material) in parts.iter().zip(&material_of) {
        let prim = part_mesh(part, &materials[*material].0);
        match part.kind {
            PartKind::Ground => world.children.push(prim),
            PartKind::Rock(_) => rocks.children.push(prim),
            PartKind::Rover(_) => rover.children.push(prim),
        }
    }
    let mut looks = Prim::new("Looks", "Scope");
    looks.children.extend(materials.iter().map(|(name, material)| surface(name, *material)));
    looks.children.extend([
        emitter("StarDome", stage.scene.sky.radiance),
        emitter("Star", stage.scene.sky.star_radiance),
    ]);
    let [dome, stars] = sky(stage);
    if !rover.children.is_empty() {
        world.children.push(rover);
    }
    world.children.extend([rocks, sun(stage), dome, stars, camera(stage), looks]);
    let knobs = serde_json::Value::Object(stage.knobs.clone()).to_string();
    let metadata = vec![
        (
            "customLayerData",
            Value::Dictionary(vec![
                ("regolith_knobs", Value::String(knobs)),
                ("regolith_seed", Value::String(stage.seed.to_string())),
                ("regolith_version", Value::String(env!("CARGO_PKG_VERSION").to_owned())),
            ]),
        ),
        ("defaultPrim", Value::Token("World".to_owned())),
        ("metersPerUnit", Value::Double(1.0)),
        ("upAxis", Value::Token("Z".to_owned())),
    ];
    Ok(Layer { metadata, prims: vec![world] })
}

fn part_mesh(part: &Part<'_>, material: &str) -> Prim {
    let points = part.vertices.iter().map(|v| v.position).collect();
    let normals = part.vertices.iter().map(|v| v.normal).collect();
    let mut prim = mesh(&part.name(), material, part.class, &part.triangles, points, Some(normals));
    prim.properties.extend(translation(part.origin));
    prim
}

/// A mesh prim with its semantic labels and material binding.
fn mesh(
    name: &str,
    material: &str,
    class: ClassId,
    triangles: &[[u32; 3]],
    points: Vec<Vec3>,
    normals: Option<Vec<Vec3>>,
) -> Prim {
    let (low, high) = points
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let indices = triangles.as_flattened().iter().map(|vertex| *vertex as i32).collect();
    let label = class.class().map_or(ROVER_LABEL, |class| class.name);
    let mut prim = Prim::new(name, "Mesh");
    let schemas = ["MaterialBindingAPI", "SemanticsLabelsAPI:class", "SemanticsAPI:Semantics_class"];
    prim.metadata.push(("apiSchemas", Value::PrependedTokens(schemas.map(str::to_owned).to_vec())));
    prim.properties = vec![
        Property::new("extent", "float3[]", Value::Vec3fArray(vec![low, high])),
        Property::new("faceVertexCounts", "int[]", Value::IntArray(vec![3; triangles.len()])),
        Property::new("faceVertexIndices", "int[]", Value::IntArray(indices)),
        Property::new("points", "point3f[]", Value::Vec3fArray(points)),
    ];
    prim.properties.extend(normals.map(|normals| {
        Property::new("normals", "normal3f[]", Value::Vec3fArray(normals))
            .with("interpolation", Value::Token("vertex".to_owned()))
    }));
    let token = |text: &str| Value::Token(text.to_owned());
    prim.properties.extend([
        Property::new("orientation", "token", token("rightHanded")).uniform(),
        Property::new("subdivisionScheme", "token", token("none")).uniform(),
        Property::relationship("material:binding", format!("/World/Looks/{material}")),
        Property::new("semantics:labels:class", "token[]", Value::TokenArray(vec![label.to_owned()])),
        Property::new(
            "semantic:Semantics_class:params:semanticData",
            "string",
            Value::String(label.to_owned()),
        ),
        Property::new(
            "semantic:Semantics_class:params:semanticType",
            "string",
            Value::String("class".to_owned()),
        ),
    ]);
    prim
}

fn translation(to: Vec3) -> [Property; 2] {
    [
        Property::new("xformOp:translate", "double3", Value::Vec3d(to.as_dvec3().to_array())),
        transform_order("xformOp:translate"),
    ]
}

fn transform_order(operation: &str) -> Property {
    Property::new("xformOpOrder", "token[]", Value::TokenArray(vec![operation.to_owned()])).uniform()
}

/// A transform from the prim's axes and position in world space. USD multiplies row vectors, so these are the rows.
fn transform(x: Vec3, y: Vec3, z: Vec3, position: Vec3) -> [Property; 2] {
    let row = |v: Vec3, last: f64| [f64::from(v.x), f64::from(v.y), f64::from(v.z), last];
    let matrix = [row(x, 0.0), row(y, 0.0), row(z, 0.0), row(position, 1.0)];
    [
        Property::new("xformOp:transform", "matrix4d", Value::Matrix4d(matrix)),
        transform_order("xformOp:transform"),
    ]
}

fn sun(stage: &Stage<'_>) -> Prim {
    let sun = &stage.scene.sun;
    let [right, up] = sun.right_and_up();
    // A scene that was built without knobs has only the sun's irradiance.
    let knob = |name: &str| stage.knobs.get(name);
    let from_irradiance = sun.irradiance / SUN_IRRADIANCE_PER_INTENSITY;
    let colour = knob("sun.color").and_then(|colour| {
        let [red, green, blue] = colour.as_array()?.as_slice() else { return None };
        Some(Vec3::new(red.as_f64()? as f32, green.as_f64()? as f32, blue.as_f64()? as f32))
    });
    let (intensity, colour) = match (knob("sun.intensity").and_then(serde_json::Value::as_f64), colour) {
        (Some(intensity), Some(colour)) => (intensity as f32, colour),
        _ => {
            let brightest = from_irradiance.max_element().max(f32::MIN_POSITIVE);
            (brightest, from_irradiance / brightest)
        }
    };
    let mut prim = Prim::new("Sun", "DistantLight");
    prim.properties = vec![
        Property::new("inputs:angle", "float", Value::Float(sun.angular_diameter_deg as f32)),
        Property::new("inputs:color", "color3f", Value::Vec3f(colour)),
        Property::new("inputs:intensity", "float", Value::Float(intensity)),
    ];
    // A distant light emits along its -Z axis.
    prim.properties.extend(transform(right, up, sun.direction, Vec3::ZERO));
    prim
}

/// The dome and the stars.
fn sky(stage: &Stage<'_>) -> [Prim; 2] {
    let sky = &stage.scene.sky;
    let Sky { directions, triangles, stars: visible, left_out } = Sky::of(stage.scene);
    let sphere = Icosphere::shared();
    let points = directions.iter().map(|d| sky.centre + sky.radius_m * *d).collect();
    let no_shadow = || Property::new("primvars:doNotCastShadows", "bool", Value::Bool(true));
    let mut dome = mesh("StarDome", "StarDome", ClassId::SKY, &triangles, points, None);
    dome.properties.push(no_shadow());

    let left_out = left_out.into_iter().map(|index| index as i32).collect();
    let mut stars = Prim::new("Stars", "Xform");
    let data = vec![
        ("holeHalfAngleDeg", Value::Double(HOLE_DEG)),
        ("starsLeftOutInHole", Value::IntArray(left_out)),
    ];
    stars.metadata.push(("customData", Value::Dictionary(data)));
    stars.children.extend(visible.into_iter().map(|(index, star)| {
        // A mesh, because not every program reads sphere prims.
        let used = &sphere.directions[..Icosphere::vertex_count(STAR_LEVEL)];
        let points = used.iter().map(|d| star.radius_m * *d).collect();
        let name = format!("Star_{index:03}");
        let mut prim = mesh(&name, "Star", ClassId::SKY, &sphere.triangles[STAR_LEVEL], points, None);
        prim.properties.push(no_shadow());
        prim.properties.extend(translation(star.centre));
        prim
    }));
    [dome, stars]
}

fn camera(stage: &Stage<'_>) -> Prim {
    let camera = &stage.scene.camera;
    let [width, height] = stage.settings.size;
    let float = |name: &'static str, value: f64| Property::new(name, "float", Value::Float(value as f32));
    let mut prim = Prim::new("RoverCam", "Camera");
    prim.properties = vec![
        Property::new("clippingRange", "float2", Value::Vec2f([camera.near_m, camera.far_m])),
        float("focalLength", APERTURE_MM / (2.0 * f64::from(camera.tan_half_fov))),
        float("horizontalAperture", APERTURE_MM),
        float("verticalAperture", APERTURE_MM * f64::from(height) / f64::from(width)),
        Property::new("projection", "token", Value::Token("perspective".to_owned())),
    ];
    prim.properties.extend(transform(camera.right, camera.up, -camera.forward, camera.eye));
    prim
}

/// A rough dielectric surface.
fn surface(name: &str, surface: Material) -> Prim {
    material(
        name,
        vec![
            Property::new("inputs:diffuseColor", "color3f", Value::Vec3f(surface.albedo)),
            Property::new("inputs:metallic", "float", Value::Float(0.0)),
            Property::new("inputs:roughness", "float", Value::Float(surface.roughness)),
        ],
    )
}

/// A material that only emits: no diffuse and no specular reflection. An index of refraction of 1 has the same effect in
/// programs that do not support the specular workflow.
fn emitter(name: &str, radiance: Vec3) -> Prim {
    material(
        name,
        vec![
            Property::new("inputs:diffuseColor", "color3f", Value::Vec3f(Vec3::ZERO)),
            Property::new("inputs:emissiveColor", "color3f", Value::Vec3f(radiance)),
            Property::new("inputs:ior", "float", Value::Float(1.0)),
            Property::new("inputs:roughness", "float", Value::Float(1.0)),
            Property::new("inputs:specularColor", "color3f", Value::Vec3f(Vec3::ZERO)),
            Property::new("inputs:useSpecularWorkflow", "int", Value::Int(1)),
        ],
    )
}

/// A material with a `UsdPreviewSurface` shader.
fn material(name: &str, inputs: Vec<Property>) -> Prim {
    let mut shader = Prim::new("Surface", "Shader");
    shader
        .properties
        .push(Property::new("info:id", "token", Value::Token("UsdPreviewSurface".to_owned())).uniform());
    shader.properties.extend(inputs);
    shader.properties.push(Property::declared("outputs:surface", "token"));
    let mut prim = Prim::new(name, "Material");
    let source = format!("/World/Looks/{name}/Surface.outputs:surface");
    prim.properties.push(Property::connected("outputs:surface", "token", source));
    prim.children.push(shader);
    prim
}

#[cfg(test)]
mod tests {
    use super::super::{Detail, Format, export};
    use super::*;
    use crate::params::Params;
    use crate::render::RenderSettings;
    use crate::scene::Scene;

    #[test]
    fn the_stage_has_all_prims_and_labels_and_the_hole_in_the_dome() {
        let params = Params::draw_default(7);
        let scene = Scene::build(7, &params).expect("a scene");
        let settings = RenderSettings::new([256, 128], 4).expect("settings");
        let knobs = params.to_json();
        let stage =
            Stage { scene: &scene, seed: 7, knobs: &knobs, settings: &settings, detail: Detail::Drawn };
        let text = String::from_utf8(export(&stage, Format::Usda).expect("exported")).expect("text");
        assert!(text.starts_with("#usda 1.0\n"));
        for (open, close) in [('{', '}'), ('(', ')'), ('[', ']')] {
            assert_eq!(text.matches(open).count(), text.matches(close).count(), "{open} {close}");
        }
        for prim in [
            "def Mesh \"Regolith\"",
            "def DistantLight \"Sun\"",
            "def Mesh \"StarDome\"",
            "def Camera \"RoverCam\"",
            "def Material \"Regolith\"",
            "float horizontalAperture = 24\n",
            "float verticalAperture = 12\n",
            "string regolith_seed = \"7\"",
        ] {
            assert_eq!(text.matches(prim).count(), 1, "{prim}");
        }
        let drawn = stage.parts().expect("parts").len() - 1;
        assert_eq!(text.matches("def Mesh \"Rock_").count(), drawn);
        assert_eq!(text.matches("token[] semantics:labels:class = [\"rock\"]").count(), drawn);
        assert_eq!(text.matches("semanticData = \"regolith\"").count(), 1);
        let stars = text.matches("def Mesh \"Star_").count();
        assert!(stars > 150 && stars <= 220, "{stars} stars outside the hole");
    }

    #[test]
    fn the_crate_file_has_all_specs_of_the_layer() {
        let params = Params::draw_default(42);
        let scene = Scene::build(42, &params).expect("a scene");
        let settings = RenderSettings::new([64, 64], 1).expect("settings");
        let knobs = params.to_json();
        let stage =
            Stage { scene: &scene, seed: 42, knobs: &knobs, settings: &settings, detail: Detail::Authored };
        let bytes = export(&stage, Format::Usdc).expect("exported");
        assert!(bytes.starts_with(b"PXR-USDC\0\x08") && bytes.len() < 40_000_000, "{} bytes", bytes.len());
        let number = |at: usize| {
            let eight: [u8; 8] = bytes[at..at + 8].try_into().expect("eight bytes");
            u64::from_le_bytes(eight) as usize
        };
        let table = number(16);
        let sections: Vec<(String, usize, usize)> = (0..number(table))
            .map(|i| table + 8 + 32 * i)
            .map(|at| {
                let name = String::from_utf8_lossy(&bytes[at..at + 16]).trim_end_matches('\0').to_owned();
                (name, number(at + 16), number(at + 24))
            })
            .collect();
        let names: Vec<&str> = sections.iter().map(|section| section.0.as_str()).collect();
        assert_eq!(names, ["TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS"]);
        assert_eq!(sections[5].1 + sections[5].2, table, "the table follows the last section");
        // A spec for the root, for each prim and for each property.
        let layer = layer(&stage).expect("a layer");
        fn count(prim: &Prim) -> usize {
            1 + prim.properties.len() + prim.children.iter().map(count).sum::<usize>()
        }
        assert_eq!(number(sections[5].1), 1 + layer.prims.iter().map(count).sum::<usize>());
        // Vertex data are stored uncompressed.
        let first = bytemuck::bytes_of(&scene.terrain.vertices[0].position);
        assert!(bytes.windows(first.len()).any(|window| window == first));
    }
}
