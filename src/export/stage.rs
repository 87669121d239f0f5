//! What is exported: the scene, divided into parts with materials.
//!
//! Must not know: formats.

use glam::Vec3;

use crate::class::ClassId;
use crate::error::Result;
use crate::render::RenderSettings;
use crate::render::select::near_plane;
use crate::render::select::selection::Selection;
use crate::scene::Scene;
use crate::scene::mesh::Vertex;
use crate::scene::rocks::{Material, Rock};

/// How much of the scene's detail is exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Every triangle of the authored meshes.
    Authored,
    /// The triangles that a frame with the stage's settings draws or that cast shadows in it.
    Drawn,
}

/// What is exported.
#[derive(Clone, Copy, Debug)]
pub struct Stage<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its seed.
    pub seed: u64,
    /// The value of every knob.
    pub knobs: &'a serde_json::Map<String, serde_json::Value>,
    /// Image size for the camera's matrix, and what [`Detail::Drawn`] is drawn with.
    pub settings: &'a RenderSettings,
    /// How much of its detail.
    pub detail: Detail,
}

/// Class name of the rover's parts, which masks ignore.
pub(super) const ROVER_LABEL: &str = "rover";

/// What a part is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PartKind {
    Ground,
    /// A rock, by its index.
    Rock(usize),
    /// A part of the rover, by its number among them.
    Rover(usize),
}

impl PartKind {
    /// The start of the names of its materials.
    const fn material(self) -> &'static str {
        match self {
            Self::Ground => "Regolith",
            Self::Rock(_) => "RockMaterial",
            Self::Rover(_) => "RoverMaterial",
        }
    }
}

/// The ground, one rock, or one part of the rover.
pub(super) struct Part<'a> {
    pub(super) class: ClassId,
    /// What it is.
    pub(super) kind: PartKind,
    /// Instance id; 0 for the ground.
    pub(super) instance: u16,
    /// Translation from object to world space.
    pub(super) origin: Vec3,
    pub(super) vertices: &'a [Vertex],
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) material: Material,
}

impl Part<'_> {
    /// Name of its node or prim.
    pub(super) fn name(&self) -> String {
        match self.kind {
            PartKind::Ground => "Regolith".to_owned(),
            PartKind::Rock(rock) => format!("Rock_{rock:03}"),
            PartKind::Rover(part) => format!("Part_{part:02}"),
        }
    }
}

/// The distinct materials of these parts with their names, in order of first use, and for each part the index of its
/// material. Rocks share a pool of materials, so there are far fewer of them than parts.
pub(super) fn materials(parts: &[Part<'_>]) -> (Vec<(String, Material)>, Vec<usize>) {
    let mut materials: Vec<(String, Material)> = Vec::new();
    let mut of_parts = Vec::with_capacity(parts.len());
    for part in parts {
        let stem = part.kind.material();
        let known = materials
            .iter()
            .position(|(name, material)| *material == part.material && name.starts_with(stem));
        of_parts.push(known.unwrap_or_else(|| {
            let name = match part.kind {
                PartKind::Ground => stem.to_owned(),
                PartKind::Rock(_) | PartKind::Rover(_) => {
                    let of_kind = materials.iter().filter(|(name, _)| name.starts_with(stem)).count();
                    format!("{stem}_{of_kind:02}")
                }
            };
            materials.push((name, part.material));
            materials.len() - 1
        }));
    }
    (materials, of_parts)
}

impl Stage<'_> {
    /// Number of the rocks that are exported.
    ///
    /// # Errors
    /// Those of [`near_plane::drawn`].
    pub fn rock_count(&self) -> Result<usize> {
        Ok(self.levels()?.iter().filter(|(body, _)| self.scene.rocks[*body].body.is_rock()).count())
    }

    /// The index and the level of detail of each rock and part of the rover that is exported.
    fn levels(&self) -> Result<Vec<(usize, usize)>> {
        Ok(match self.detail {
            Detail::Authored => {
                self.scene.rocks.iter().enumerate().map(|(rock, r)| (rock, r.level)).collect()
            }
            Detail::Drawn => self
                .drawn()?
                .rocks
                .iter()
                .filter_map(|s| Some((s.rock, s.visible_level.or(s.caster.map(|(_, level)| level))?)))
                .collect(),
        })
    }

    /// The ground, then the rocks in order of index, then the parts of the rover. Of what is drawn, rocks that are too small to be labelled
    /// as rocks are regolith, as in the frame.
    ///
    /// # Errors
    /// Those of [`near_plane::drawn`].
    pub(super) fn parts(&self) -> Result<Vec<Part<'_>>> {
        let scene = self.scene;
        let mut parts = vec![Part {
            class: ClassId::REGOLITH,
            kind: PartKind::Ground,
            instance: 0,
            origin: Vec3::ZERO,
            vertices: &scene.terrain.vertices,
            // With every level of detail: the whole ground casts shadows.
            triangles: scene.terrain.triangles().collect(),
            material: scene.regolith,
        }];
        let first_part = scene.rocks.count();
        let focal_px = scene.camera.focal_px(self.settings.size[0]) as f32;
        let is_labelled_rock = |rock: &Rock| {
            self.detail == Detail::Authored
                || scene.label_rule.draws_as_rock(rock, scene.camera.eye, focal_px)
        };
        parts.extend(self.levels()?.into_iter().map(|(index, level)| {
            let rock = &scene.rocks[index];
            let triangles = rock.triangles(level).to_vec();
            let used = triangles.as_flattened().iter().max().map_or(0, |last| *last as usize + 1);
            let (class, kind, instance) = if !rock.body.is_rock() {
                (ClassId::UNLABELLED, PartKind::Rover(index - first_part), 0)
            } else if is_labelled_rock(rock) {
                (ClassId::ROCK, PartKind::Rock(index), rock.index as u16 + 1)
            } else {
                (ClassId::REGOLITH, PartKind::Rock(index), 0)
            };
            Part {
                class,
                kind,
                instance,
                origin: rock.centre,
                vertices: &rock.vertices[..used],
                triangles,
                material: rock.material,
            }
        }));
        Ok(parts)
    }

    /// The rocks and levels of detail that a frame draws.
    fn drawn(&self) -> Result<Selection> {
        let (camera, size) = near_plane::drawn(&self.scene.camera, self.settings.size)?;
        let settings = RenderSettings { size, ..*self.settings };
        Ok(Selection::new(&Scene { camera, ..self.scene.clone() }, &settings))
    }
}
