//! The scene as an OpenUSD stage in text form, with the prims and labels of the stage that it stands in for.
//!
//! Dome and stars are geometry here, for other programs have no sky of ours; the dome has a hole around the sun, and
//! stars in it are left out (their numbers are in the custom data of `/World/Stars`), so that a path tracer's shadow
//! rays reach it.
//! Must not know: which triangles a frame draws; [`Stage::parts`] gives them.

use std::fmt::Write as _;

use glam::Vec3;

use super::{Part, Stage, looks};
use crate::class::ClassId;
use crate::error::Result;
use crate::scene::mesh::Icosphere;
use crate::scene::rocks::Material;
use crate::scene::sky::{DOME_RADIANCE, STAR_RADIANCE, SUN_IRRADIANCE_PER_INTENSITY, Star};

/// Half the angle of the dome's hole around the sun, degrees.
const HOLE_DEG: f64 = 34.0;
/// Level of the icosphere that the dome is.
const DOME_LEVEL: usize = 4;
/// Level of the icosphere that a star is.
const STAR_LEVEL: usize = 1;
/// Width of the camera's film, millimetres.
const APERTURE_MM: f64 = 24.0;

pub(super) fn encode(stage: &Stage<'_>) -> Result<Vec<u8>> {
    let mut text = String::with_capacity(96 << 20);
    // Writing into a string cannot fail.
    let _ = write_stage(&mut text, stage);
    Ok(text.into_bytes())
}

fn write_stage(out: &mut String, stage: &Stage<'_>) -> std::fmt::Result {
    let knobs = serde_json::Value::Object(stage.knobs.clone()).to_string();
    write!(
        out,
        "#usda 1.0\n(\n    customLayerData = {{\n        string regolith_knobs = {knobs:?}\n        \
         string regolith_seed = \"{}\"\n        string regolith_version = \"{}\"\n    }}\n    \
         defaultPrim = \"World\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\ndef Xform \"World\"\n{{\n",
        stage.seed,
        env!("CARGO_PKG_VERSION")
    )?;
    let parts = stage.parts();
    let (looks, look_of) = looks(&parts);
    let named = |wanted: bool| {
        let looks = &looks;
        let pairs = parts.iter().zip(&look_of).filter(move |(part, _)| part.rock.is_some() == wanted);
        pairs.map(move |(part, look)| (part, looks[*look].0.as_str()))
    };
    for (ground, look) in named(false) {
        write_part(out, ground, look, "    ")?;
    }
    writeln!(out, "    def Xform \"Rocks\"\n    {{")?;
    for (rock, look) in named(true) {
        write_part(out, rock, look, "        ")?;
    }
    writeln!(out, "    }}")?;
    write_sun(out, stage)?;
    write_sky(out, stage)?;
    write_camera(out, stage)?;
    writeln!(out, "    def Scope \"Looks\"\n    {{")?;
    for (name, material) in &looks {
        write_surface(out, name, *material)?;
    }
    write_emitter(out, "StarDome", DOME_RADIANCE)?;
    write_emitter(out, "Star", STAR_RADIANCE)?;
    writeln!(out, "    }}\n}}")
}

/// Labels and material of a prim, as metadata in parentheses and as properties.
fn schemas(class: ClassId) -> (String, String) {
    let name = class.class().map_or("", |class| class.name);
    let applied = "prepend apiSchemas = [\"MaterialBindingAPI\", \"SemanticsLabelsAPI:class\", \
                   \"SemanticsAPI:Semantics_class\"]";
    let labels = format!(
        "token[] semantics:labels:class = [\"{name}\"]\n\
         string semantic:Semantics_class:params:semanticData = \"{name}\"\n\
         string semantic:Semantics_class:params:semanticType = \"class\""
    );
    (applied.to_owned(), labels)
}

fn write_part(out: &mut String, part: &Part<'_>, look: &str, indent: &str) -> std::fmt::Result {
    let name = part.name();
    let positions = || part.vertices.iter().map(|v| v.position);
    let normals = || part.vertices.iter().map(|v| v.normal);
    write_mesh(out, indent, &name, look, part.class, &part.triangles, positions, Some(normals))?;
    let [x, y, z] = part.origin.to_array();
    write!(
        out,
        "{indent}    double3 xformOp:translate = ({x}, {y}, {z})\n\
         {indent}    uniform token[] xformOpOrder = [\"xformOp:translate\"]\n{indent}}}\n"
    )
}

/// A mesh without its closing brace.
#[expect(clippy::too_many_arguments, reason = "one line of each makes a mesh")]
fn write_mesh<P: Iterator<Item = Vec3>, N: Iterator<Item = Vec3>>(
    out: &mut String,
    indent: &str,
    name: &str,
    material: &str,
    class: ClassId,
    triangles: &[[u32; 3]],
    positions: impl Fn() -> P,
    normals: Option<impl Fn() -> N>,
) -> std::fmt::Result {
    let (applied, labels) = schemas(class);
    let (low, high) =
        positions().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    write!(out, "{indent}def Mesh \"{name}\" (\n{indent}    {applied}\n{indent})\n{indent}{{\n")?;
    writeln!(out, "{indent}    float3[] extent = [{}, {}]", Tuple(low), Tuple(high))?;
    write_list(out, indent, "int[] faceVertexCounts", triangles.iter().map(|_| 3))?;
    write_list(out, indent, "int[] faceVertexIndices", triangles.as_flattened().iter())?;
    write_list(out, indent, "point3f[] points", positions().map(Tuple))?;
    if let Some(normals) = normals {
        write_list(out, indent, "normal3f[] normals", normals().map(Tuple))?;
        // The interpolation is metadata of the list that was just written.
        out.truncate(out.trim_end().len());
        write!(out, " (\n{indent}        interpolation = \"vertex\"\n{indent}    )\n")?;
    }
    write!(
        out,
        "{indent}    uniform token orientation = \"rightHanded\"\n\
         {indent}    uniform token subdivisionScheme = \"none\"\n\
         {indent}    rel material:binding = </World/Looks/{material}>\n"
    )?;
    for line in labels.lines() {
        writeln!(out, "{indent}    {line}")?;
    }
    Ok(())
}

/// A vector as USD writes it.
struct Tuple(Vec3);

impl std::fmt::Display for Tuple {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.0.to_array();
        write!(f, "({x}, {y}, {z})")
    }
}

fn write_list<T: std::fmt::Display>(
    out: &mut String,
    indent: &str,
    declaration: &str,
    items: impl Iterator<Item = T>,
) -> std::fmt::Result {
    write!(out, "{indent}    {declaration} = [")?;
    for (i, item) in items.enumerate() {
        let comma = if i > 0 { ", " } else { "" };
        write!(out, "{comma}{item}")?;
    }
    out.push_str("]\n");
    Ok(())
}

/// Rows of a USD transform (row vectors): where the prim's axes point, and its place.
fn matrix(x: Vec3, y: Vec3, z: Vec3, place: Vec3) -> String {
    let row = |v: Vec3, last: u8| format!("({}, {}, {}, {last})", v.x, v.y, v.z);
    format!("( {}, {}, {}, {} )", row(x, 0), row(y, 0), row(z, 0), row(place, 1))
}

fn write_sun(out: &mut String, stage: &Stage<'_>) -> std::fmt::Result {
    let sun = &stage.scene.sun;
    // A distant light shines along its -Z.
    let [right, up] = sun.right_and_up();
    // A scene made by hand has no such knobs; then the sun's own irradiance gives them.
    let knob = |name: &str| stage.knobs.get(name);
    let own = sun.irradiance / SUN_IRRADIANCE_PER_INTENSITY;
    let colour = knob("sun.color").and_then(|colour| {
        let [red, green, blue] = colour.as_array()?.as_slice() else { return None };
        Some([red.as_f64()?, green.as_f64()?, blue.as_f64()?])
    });
    let (intensity, [red, green, blue]) =
        match (knob("sun.intensity").and_then(serde_json::Value::as_f64), colour) {
            (Some(intensity), Some(colour)) => (intensity, colour),
            _ => {
                let brightest = own.max_element().max(f32::MIN_POSITIVE);
                (f64::from(brightest), (own / brightest).to_array().map(f64::from))
            }
        };
    write!(
        out,
        "    def DistantLight \"Sun\"\n    {{\n        float inputs:angle = {}\n        color3f inputs:color = ({red}, {green}, {blue})\n        \
         float inputs:intensity = {intensity}\n        matrix4d xformOp:transform = {}\n        \
         uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}\n",
        sun.angular_diameter_deg,
        matrix(right, up, sun.direction, Vec3::ZERO)
    )
}

fn write_sky(out: &mut String, stage: &Stage<'_>) -> std::fmt::Result {
    let (sky, sun) = (&stage.scene.sky, &stage.scene.sun);
    let edge = libm::cos(HOLE_DEG.to_radians()) as f32;
    let in_hole = |direction: Vec3| direction.dot(sun.direction) > edge;
    let sphere = Icosphere::shared();
    // Only the directions that a triangle uses, numbered anew.
    let mut number_of = vec![None; Icosphere::vertex_count(DOME_LEVEL)];
    let mut directions: Vec<Vec3> = Vec::new();
    let mut number = |v: u32| {
        *number_of[v as usize].get_or_insert_with(|| {
            directions.push(sphere.directions[v as usize]);
            directions.len() as u32 - 1
        })
    };
    // Turned inside out: its front faces the scene.
    let triangles: Vec<[u32; 3]> = sphere.triangles[DOME_LEVEL]
        .iter()
        .filter(|t| !t.iter().any(|v| in_hole(sphere.directions[*v as usize])))
        .map(|&[a, b, c]| [a, c, b].map(&mut number))
        .collect();
    let positions = || directions.iter().map(|d| sky.centre + sky.radius_m * *d);
    let none: Option<fn() -> std::iter::Empty<Vec3>> = None;
    write_mesh(out, "    ", "StarDome", "StarDome", ClassId::SKY, &triangles, positions, none)?;
    let hidden = |star: &Star| in_hole((star.centre - sky.centre).normalize());
    let left_out: Vec<String> = sky
        .stars
        .iter()
        .enumerate()
        .filter(|(_, star)| hidden(star))
        .map(|(index, _)| index.to_string())
        .collect();
    write!(
        out,
        "        bool primvars:doNotCastShadows = 1\n    }}\n    def Xform \"Stars\" (\n        customData = {{\n            \
         double holeHalfAngleDeg = {HOLE_DEG}\n            int[] starsLeftOutInHole = [{}]\n        }}\n    )\n    {{\n",
        left_out.join(", ")
    )?;
    for (index, star) in sky.stars.iter().enumerate().filter(|(_, star)| !hidden(star)) {
        // A mesh rather than a sphere prim, which not every program reads.
        let used = Icosphere::vertex_count(STAR_LEVEL);
        let positions = || sphere.directions[..used].iter().map(|d| star.radius_m * *d);
        let none: Option<fn() -> std::iter::Empty<Vec3>> = None;
        let (name, triangles) = (format!("Star_{index:03}"), &sphere.triangles[STAR_LEVEL]);
        write_mesh(out, "        ", &name, "Star", ClassId::SKY, triangles, positions, none)?;
        write!(
            out,
            "            bool primvars:doNotCastShadows = 1\n            double3 xformOp:translate = {}\n            \
             uniform token[] xformOpOrder = [\"xformOp:translate\"]\n        }}\n",
            Tuple(star.centre)
        )?;
    }
    writeln!(out, "    }}")
}

fn write_camera(out: &mut String, stage: &Stage<'_>) -> std::fmt::Result {
    let camera = &stage.scene.camera;
    let [width, height] = stage.settings.size;
    write!(
        out,
        "    def Camera \"RoverCam\"\n    {{\n        float2 clippingRange = ({}, {})\n        float focalLength = {}\n        \
         float horizontalAperture = {APERTURE_MM}\n        float verticalAperture = {}\n        \
         token projection = \"perspective\"\n        matrix4d xformOp:transform = {}\n        \
         uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}\n",
        camera.near_m,
        camera.far_m,
        APERTURE_MM / (2.0 * f64::from(camera.tan_half_fov)),
        APERTURE_MM * f64::from(height) / f64::from(width),
        matrix(camera.right, camera.up, -camera.forward, camera.eye)
    )
}

fn write_surface(out: &mut String, name: &str, material: Material) -> std::fmt::Result {
    let inputs = format!(
        "color3f inputs:diffuseColor = {}\nfloat inputs:metallic = 0\nfloat inputs:roughness = {}",
        Tuple(material.albedo),
        material.roughness
    );
    write_material(out, name, &inputs)
}

/// Unlit: no diffuse, no specular reflection, only its own light.
fn write_emitter(out: &mut String, name: &str, radiance: Vec3) -> std::fmt::Result {
    let inputs = format!(
        "color3f inputs:diffuseColor = (0, 0, 0)\ncolor3f inputs:emissiveColor = {}\nfloat inputs:roughness = 1\n\
         color3f inputs:specularColor = (0, 0, 0)\nint inputs:useSpecularWorkflow = 1",
        Tuple(radiance)
    );
    write_material(out, name, &inputs)
}

fn write_material(out: &mut String, name: &str, inputs: &str) -> std::fmt::Result {
    write!(
        out,
        "        def Material \"{name}\"\n        {{\n            \
         token outputs:surface.connect = </World/Looks/{name}/Surface.outputs:surface>\n\n            \
         def Shader \"Surface\"\n            {{\n                uniform token info:id = \"UsdPreviewSurface\"\n"
    )?;
    for line in inputs.lines() {
        writeln!(out, "                {line}")?;
    }
    write!(out, "                token outputs:surface\n            }}\n        }}\n")
}

#[cfg(test)]
mod tests {
    use super::super::{Detail, Format, export};
    use super::*;
    use crate::params::Params;
    use crate::render::RenderSettings;
    use crate::scene::Scene;

    #[test]
    fn the_stage_has_its_prims_labels_and_hole() {
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
        let drawn = stage.parts().len() - 1;
        assert_eq!(text.matches("def Mesh \"Rock_").count(), drawn);
        assert_eq!(text.matches("token[] semantics:labels:class = [\"rock\"]").count(), drawn);
        assert_eq!(text.matches("semanticData = \"regolith\"").count(), 1);
        let stars = text.matches("def Mesh \"Star_").count();
        assert!(stars > 150 && stars <= 220, "{stars} stars outside the hole");
    }
}
