//! Where the meshes of a scene lie in the vertex buffer.
//!
//! Vertices of a rock get a place when it is first drawn, and another when it is drawn at a finer level: those of a level are the first of
//! each finer one.
//! Must not know: a device.

use std::sync::{Arc, Weak};

use crate::pool::PooledVec;
use crate::render::select::selection::Selection;
use crate::render::visibility::packed_vertices::{MeshList, unit_sphere, vertices_of};
use crate::scene::Scene;
use crate::scene::mesh::Vertex;
use crate::scene::terrain::Terrain;

/// The places of the unit sphere, the ground and rocks. Weak references keep addresses from being used again.
#[derive(Debug, Default)]
pub(crate) struct MeshPlaces {
    /// The ground whose vertices have a place.
    terrain: Weak<Terrain>,
    /// First vertex of the ground.
    ground: i32,
    /// The places of each rock of the scene.
    rocks: Vec<RockPlace>,
    /// Number of vertices that have a place.
    len: usize,
}

/// The place of a rock.
#[derive(Clone, Debug, Default)]
struct RockPlace {
    /// Its mesh; a dangling reference where it has no place.
    mesh: Weak<PooledVec<Vertex>>,
    first: i32,
    count: usize,
}

impl MeshPlaces {
    /// Whether the ground of the scene has a place.
    pub(super) fn has_ground(&self, scene: &Scene) -> bool {
        self.terrain.as_ptr() == Arc::as_ptr(&scene.terrain)
    }

    /// Number of vertices that have a place.
    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// First vertex of the ground.
    pub(super) const fn ground(&self) -> i32 {
        self.ground
    }

    /// First vertex of a rock.
    pub(super) fn rock(&self, rock: usize) -> i32 {
        self.rocks[rock].first
    }

    /// Gives places to the meshes of a selection that have none; all, from the first vertex on, if the ground has none. Returns them.
    pub(crate) fn add<'a>(&mut self, scene: &'a Scene, selection: &Selection) -> MeshList<'a> {
        let mut added = MeshList::default();
        if !self.has_ground(scene) {
            *self = Self { terrain: Arc::downgrade(&scene.terrain), ..Self::default() };
            added.push(unit_sphere());
            self.ground = added.push(&scene.terrain.vertices) as i32;
        }
        self.rocks.resize(scene.rocks.len(), RockPlace::default());
        for selected in &selection.rocks {
            let (place, rock) = (&mut self.rocks[selected.rock], &scene.rocks[selected.rock]);
            let vertices = vertices_of(scene, selected);
            let count = vertices.len();
            let has_place = place.mesh.as_ptr() == Arc::as_ptr(&rock.vertices) && place.count >= count;
            if !has_place {
                let first = (self.len + added.push(vertices)) as i32;
                *place = RockPlace { mesh: Arc::downgrade(&rock.vertices), first, count };
            }
        }
        self.len += added.len();
        added
    }
}
