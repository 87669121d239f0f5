//! The scene as files for other programs: one format a file here.
//!
//! Holds the authored triangles, or exactly those that a frame draws.
//! Must not know: where bytes are written.
//! To add a format: a file in `export/` with a function from [`Stage`] to bytes, a row in [`Format::ALL`], an arm in
//! [`export`].

mod gltf;
mod npz;
mod sky;
mod usd;

use std::path::Path;

use glam::Vec3;

use crate::class::ClassId;
use crate::error::{Error, Result};
use crate::render::RenderSettings;
use crate::render::select::near_plane;
use crate::render::select::selection::Selection;
use crate::scene::Scene;
use crate::scene::mesh::Vertex;
use crate::scene::rocks::Material;

/// A format that a scene can be written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// NumPy arrays.
    Npz,
    /// Binary glTF 2.0.
    Glb,
    /// OpenUSD, as text.
    Usda,
    /// OpenUSD, as a binary crate.
    Usdc,
}

impl Format {
    /// Every format with its extension.
    pub const ALL: [(Self, &'static str); 4] =
        [(Self::Npz, "npz"), (Self::Glb, "glb"), (Self::Usda, "usda"), (Self::Usdc, "usdc")];

    /// The format of a file by its extension.
    ///
    /// # Errors
    /// [`Error::Usage`] for any other.
    pub fn from_path(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        let known = Self::ALL.iter().find(|(_, known)| extension.as_deref() == Some(*known));
        known.map(|(format, _)| *format).ok_or_else(|| {
            let names: Vec<String> = Self::ALL.iter().map(|(_, name)| format!(".{name}")).collect();
            Error::Usage(format!(
                "{}: the extension tells the format; there are {}",
                path.display(),
                names.join(", ")
            ))
        })
    }
}

/// How much of the scene's detail is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Every triangle.
    Authored,
    /// The triangles that a frame with the stage's settings draws or lets cast shadows.
    Drawn,
}

/// What is exported.
#[derive(Clone, Copy, Debug)]
pub struct Stage<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its seed.
    pub seed: u64,
    /// Its knobs as used.
    pub knobs: &'a serde_json::Map<String, serde_json::Value>,
    /// For the camera's matrix and for [`Detail::Drawn`].
    pub settings: &'a RenderSettings,
    /// How much of it.
    pub detail: Detail,
}

/// The bytes of the file.
///
/// # Errors
/// [`Error::Encode`].
pub fn export(stage: &Stage<'_>, format: Format) -> Result<Vec<u8>> {
    match format {
        Format::Npz => npz::encode(stage),
        Format::Glb => gltf::encode(stage),
        Format::Usda => usd::encode_text(stage),
        Format::Usdc => usd::encode_crate(stage),
    }
}

/// One thing of the scene.
struct Part<'a> {
    class: ClassId,
    /// Index of the rock; none for the ground.
    rock: Option<usize>,
    /// 0 for what is no rock.
    instance: u16,
    origin: Vec3,
    vertices: &'a [Vertex],
    triangles: Vec<[u32; 3]>,
    material: Material,
}

impl Part<'_> {
    /// Name of its node or prim.
    fn name(&self) -> String {
        self.rock.map_or_else(|| "Regolith".to_owned(), |rock| format!("Rock_{rock:03}"))
    }
}

/// The distinct materials of some parts with their names, in the order in which they are met, and for each part the
/// index of its own. Rocks share a pool, so there are far fewer than parts.
fn looks(parts: &[Part<'_>]) -> (Vec<(String, Material)>, Vec<usize>) {
    let mut looks: Vec<(String, Material)> = Vec::new();
    let (mut of_parts, mut rock_looks) = (Vec::with_capacity(parts.len()), 0);
    for part in parts {
        let known = looks.iter().position(|(name, material)| {
            *material == part.material && (name == "Regolith") == part.rock.is_none()
        });
        of_parts.push(known.unwrap_or_else(|| {
            let name = if part.rock.is_some() {
                rock_looks += 1;
                format!("RockMaterial_{:02}", rock_looks - 1)
            } else {
                "Regolith".to_owned()
            };
            looks.push((name, part.material));
            looks.len() - 1
        }));
    }
    (looks, of_parts)
}

impl Stage<'_> {
    /// Ground, then the rocks by number.
    ///
    /// # Errors
    /// Those of [`near_plane::drawn`].
    fn parts(&self) -> Result<Vec<Part<'_>>> {
        let scene = self.scene;
        let mut parts = vec![Part {
            class: ClassId::REGOLITH,
            rock: None,
            instance: 0,
            origin: Vec3::ZERO,
            vertices: &scene.terrain.vertices,
            // All of the ground casts shadows.
            triangles: scene.terrain.triangles().collect(),
            material: scene.regolith,
        }];
        let levels: Vec<(usize, usize)> = match self.detail {
            Detail::Authored => scene.rocks.iter().enumerate().map(|(rock, r)| (rock, r.level)).collect(),
            Detail::Drawn => self
                .drawn()?
                .rocks
                .iter()
                .filter_map(|s| Some((s.rock, s.visible_level.or(s.caster.map(|(_, level)| level))?)))
                .collect(),
        };
        parts.extend(levels.into_iter().map(|(index, level)| {
            let rock = &scene.rocks[index];
            let triangles = rock.triangles(level).to_vec();
            let used = triangles.as_flattened().iter().max().map_or(0, |last| *last as usize + 1);
            Part {
                class: ClassId::ROCK,
                rock: Some(index),
                instance: rock.index as u16 + 1,
                origin: rock.centre,
                vertices: &rock.vertices[..used],
                triangles,
                material: rock.material,
            }
        }));
        Ok(parts)
    }

    /// What a frame draws.
    fn drawn(&self) -> Result<Selection> {
        let (camera, size) = near_plane::drawn(&self.scene.camera, self.settings.size)?;
        let settings = RenderSettings { size, ..*self.settings };
        Ok(Selection::new(&Scene { camera, ..self.scene.clone() }, &settings))
    }
}
