//! A scene: everything there is to draw, as plain data in metres, made from one seed and one set of values.
//!
//! Must not know: wgpu, picture sizes, files. `Scene` is made by [`Scene::build`], or by hand in a test: the
//! renderer sees no difference.
//! To add an element: a file in `scene/` with its `build`, one line in [`Scene::build`], one in
//! [`Scene::hash_geometry`], and a class in `class.rs` if it is a new one.

pub mod camera;
pub mod mesh;
pub mod noise;
pub mod rocks;
pub mod sky;
pub mod terrain;

use bytemuck::bytes_of;
use glam::Vec3;
use twox_hash::XxHash3_128;

use crate::error::Result;
use crate::params::{Knob, Params};
use crate::random::Streams;
use camera::Camera;
use rocks::{Material, Rock};
use sky::{Sky, Sun};
use terrain::Terrain;

/// Colour of the regolith before it is scaled to the albedo knob, linear RGB.
const REGOLITH_TINT: [f64; 3] = [0.22, 0.205, 0.19];

/// Everything that a frame shows.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The ground.
    pub terrain: Terrain,
    /// How the ground reflects.
    pub regolith: Material,
    /// The boulders, by number.
    pub rocks: Vec<Rock>,
    /// Dome and stars.
    pub sky: Sky,
    /// The sun.
    pub sun: Sun,
    /// The rover's camera.
    pub camera: Camera,
}

impl Scene {
    /// The scene of a seed and its values. The same on every machine and for every number of threads.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] if the camera cannot stand where it was put.
    pub fn build(seed: u64, params: &Params) -> Result<Self> {
        let streams = Streams::new(seed);
        let terrain = Terrain::build(&streams, params);
        let camera = Camera::build(params, &terrain)?;
        let ground = camera.eye.truncate().extend(terrain.height_at(camera.eye.truncate()));
        Ok(Self {
            regolith: regolith(params),
            rocks: rocks::build(&streams, params, &terrain, camera.eye),
            sky: Sky::build(&streams, params, ground),
            sun: Sun::build(params),
            terrain,
            camera,
        })
    }

    /// Numbers of the rocks that were moved because they came too near to the eye.
    #[must_use]
    pub fn moved_rocks(&self) -> Vec<u32> {
        self.rocks.iter().filter(|rock| rock.moved).map(|rock| rock.index).collect()
    }

    /// Hash (XXH3, 128 bits, hexadecimal) of every vertex, its place in the world, and of dome and stars.
    #[must_use]
    pub fn geometry_hash(&self) -> String {
        let mut hasher = XxHash3_128::new();
        self.hash_geometry(|bytes| hasher.write(bytes));
        format!("{:032x}", hasher.finish_128())
    }

    fn hash_geometry(&self, mut write: impl FnMut(&[u8])) {
        write(&self.terrain.cells.to_le_bytes());
        write(bytemuck::cast_slice(&self.terrain.vertices));
        for rock in &self.rocks {
            write(&rock.index.to_le_bytes());
            write(bytes_of(&rock.centre));
            write(bytemuck::cast_slice(&rock.vertices));
        }
        write(bytes_of(&self.sky.centre));
        write(&self.sky.radius_m.to_le_bytes());
        for star in &self.sky.stars {
            write(bytes_of(&star.centre));
            write(&star.radius_m.to_le_bytes());
        }
    }
}

/// The ground's material: the regolith's tint with the albedo knob as its mean.
fn regolith(params: &Params) -> Material {
    let mean = REGOLITH_TINT.iter().sum::<f64>() / 3.0;
    let scale = params.number(Knob::RegolithAlbedo) / mean;
    Material {
        albedo: Vec3::from(REGOLITH_TINT.map(|channel| (channel * scale).min(1.0) as f32)),
        roughness: params.number(Knob::RegolithRoughness) as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::sampler::Config;

    fn scene(seed: u64, set: &[&str]) -> Scene {
        let mut config = Config::new();
        for assignment in set {
            config.apply_set(assignment).expect("a valid setting");
        }
        Scene::build(seed, &config.draw(seed).expect("drawn")).expect("built")
    }

    #[test]
    fn threads_do_not_change_a_bit_of_the_geometry() {
        let hash_on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| scene(42, &[]).geometry_hash())
        };
        let one = hash_on(1);
        assert_eq!(one, hash_on(2));
        assert_eq!(one, hash_on(8));
        assert_ne!(one, scene(43, &[]).geometry_hash());
    }

    #[test]
    fn more_craters_move_neither_a_star_nor_a_rock() {
        let (few, more) = (scene(9, &["craters.count=6"]), scene(9, &["craters.count=10"]));
        assert_eq!(few.terrain.craters[..], more.terrain.craters[..6]);
        for (a, b) in few.rocks.iter().zip(&more.rocks) {
            assert_eq!(a.centre.truncate(), b.centre.truncate());
            assert_eq!(a.vertices, b.vertices);
        }
        for (a, b) in few.sky.stars.iter().zip(&more.sky.stars) {
            assert_eq!(a.centre - few.sky.centre, b.centre - more.sky.centre);
        }
    }

    #[test]
    fn regolith_has_the_mean_albedo_of_its_knob() {
        let albedo = scene(1, &["regolith.albedo=0.3"]).regolith.albedo;
        assert!(((albedo.x + albedo.y + albedo.z) / 3.0 - 0.3).abs() < 1e-6);
        assert!(albedo.x > albedo.y && albedo.y > albedo.z);
    }
}
