//! A scene: everything there is to render, as plain data in metres, built from one seed and one set of parameters.
//!
//! Must not know: wgpu, image sizes, files. `Scene` is built by [`Scene::build`], or field by field in a test.
//! To add an element: a file in `scene/` with its `build`, one line in [`Scene::build`], one in `Scene::hash_geometry`, and a
//! class in `class.rs` if it is a new one.

pub mod azimuth;
pub mod bounce;
pub mod camera;
pub mod crater_rays;
pub mod crater_wall;
pub mod craters;
pub mod far_hills;
pub mod fillet;
pub mod flare;
pub mod grains;
pub mod grid_cell;
pub(crate) mod ground_range;
pub mod label_rule;
pub mod lattice;
pub mod mesh;
pub mod noise;
pub mod nominal_craters;
pub mod photometry;
pub mod relief;
pub mod rings;
pub mod rings_mesh;
pub mod rocks;
pub mod rover;
pub mod rover_tracks;
pub mod sensor;
pub mod size_distribution;
pub mod sky;
pub mod square_grid;
pub mod terrain;
pub mod track;

use std::sync::Arc;

use bytemuck::bytes_of;
use glam::Vec3;
use twox_hash::XxHash3_128;

use crate::error::Result;
use crate::params::{Knob, Params, Stage};
use crate::random::Streams;
use camera::Camera;
use crater_wall::CraterWall;
use flare::Flare;
use label_rule::LabelRule;
use photometry::{Photometry, tinted};
use relief::Relief;
use rocks::on_demand::Rocks;
use rocks::{Material, burial, fillets, lunar, lunar_rocks};
use rover::Rover;
use sensor::Sensor;
use sky::{Sky, Sun};
use terrain::Terrain;
use track::Track;

/// Colour of the regolith before it is scaled to the albedo knob, linear RGB.
const REGOLITH_TINT: [f64; 3] = [0.22, 0.205, 0.19];

/// Everything that can be rendered.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The ground. Clones of a scene share it.
    pub terrain: Arc<Terrain>,
    /// Surface stage: the height function that the ground was sampled from.
    pub relief: Option<Relief>,
    /// Material of the ground.
    pub regolith: Material,
    /// Photometric functions of ground and rocks.
    pub photometry: Photometry,
    /// Which rocks and craters count in the labels.
    pub label_rule: LabelRule,
    /// The rocks, by index, and behind them the parts of the rover.
    pub rocks: Rocks,
    /// Number of rocks of the surface stage that are left out because they would stand in or beside the camera.
    pub left_out_rocks: u32,
    /// Dome and stars.
    pub sky: Sky,
    /// The sun.
    pub sun: Sun,
    /// The rover's camera.
    pub camera: Camera,
    /// Sensor model applied to the image, if any.
    pub sensor: Option<Sensor>,
    /// Ghosts of the sun in the camera's lens; only a sensor shows them.
    pub flare: Flare,
}

impl Scene {
    /// The scene of a seed and its parameters: the same bits on every machine and for every number of threads.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] if the camera is too low or outside the sky dome, or a crater has no room for its wall.
    pub fn build(seed: u64, params: &Params) -> Result<Self> {
        Self::build_for_pose(seed, params, params)
    }

    /// The scene of the parameters `first` for another camera, that of `params`, which differ in nothing but camera and sun: what counts from
    /// the camera, the wall of a crater, hills, rays and tracks, counts from the first one.
    ///
    /// # Errors
    /// Those of [`Self::build`].
    pub(crate) fn build_for_pose(seed: u64, params: &Params, first: &Params) -> Result<Self> {
        let streams = Streams::new(seed);
        match params.stage() {
            Stage::Nominal => Self::nominal(&streams, params),
            Stage::Surface => Self::surface(&streams, params, first),
        }
    }

    fn nominal(streams: &Streams, params: &Params) -> Result<Self> {
        let terrain = Arc::new(Terrain::build(streams, params));
        let camera = Camera::build(params, &terrain)?;
        let rocks = rocks::plan(streams, params, &terrain, camera.eye);
        Ok(Self::assembled(streams, params, (terrain, None), rocks, nominal_regolith(params), camera))
    }

    fn surface(streams: &Streams, params: &Params, first: &Params) -> Result<Self> {
        let centre = camera::position(params);
        let view = camera::ground_view(params);
        let to_first = camera::position(first) - centre;
        let mut relief = Relief::new(streams, first, centre).counted_from(first, to_first);
        relief.wall.as_ref().map_or(Ok(()), CraterWall::check)?;
        let tracks = rover_tracks::tracks(streams, first).into_iter();
        relief.tracks = tracks.map(|track| Track { offset: track.offset + to_first, ..track }).collect();
        let (mut placements, left_out_rocks) = lunar::placements(streams, params, &relief, &view, centre);
        rover::remove_overlapping_rocks(params, centre, &mut placements);
        let number = |knob| params.number(knob);
        let regolith = Material {
            albedo: tinted(
                number(Knob::RegolithAlbedo),
                number(Knob::RegolithRedOverGreen),
                number(Knob::RegolithBlueOverGreen),
            ),
            roughness: number(Knob::RegolithRoughness) as f32,
        };
        let mut rocks = lunar_rocks::build(streams, params, centre, &regolith, &placements);
        relief.fillets = fillets::fillets(streams, params, (&relief, &view, centre), &placements, &rocks);
        let terrain = Terrain::rings(&relief, &view, centre);
        let camera = Camera::build(params, &terrain)?;
        burial::bury(streams, params, (&terrain, camera.eye), &placements, &mut rocks);
        let ground = (Arc::new(terrain), Some(relief));
        let scene = Self::assembled(streams, params, ground, rocks.into(), regolith, camera);
        Ok(Self { left_out_rocks, ..scene })
    }

    fn assembled(
        streams: &Streams,
        params: &Params,
        (terrain, relief): (Arc<Terrain>, Option<Relief>),
        rocks: Rocks,
        regolith: Material,
        camera: Camera,
    ) -> Self {
        let below_eye = camera.eye.truncate();
        let rocks = with_rover(params, rocks, &terrain, camera.eye);
        Self {
            sky: Sky::build(streams, params, below_eye.extend(terrain.height_at(below_eye))),
            photometry: Photometry::build(params),
            label_rule: LabelRule::build(params),
            sun: Sun::build(params),
            sensor: Sensor::build(streams, params),
            flare: Flare::build(streams, params),
            regolith,
            rocks,
            left_out_rocks: 0,
            relief,
            terrain,
            camera,
        }
    }

    /// The same stage seen by another camera, which takes its rover along.
    #[must_use]
    pub(crate) fn seen_by(self, params: &Params, camera: Camera) -> Self {
        let rocks = with_rover(params, self.rocks.without_parts(), &self.terrain, camera.eye);
        Self { camera, rocks, ..self }
    }

    /// Whether a rover carries the camera.
    pub(crate) fn has_rover(&self) -> bool {
        self.rocks.count() < self.rocks.len()
    }

    /// Indices of the rocks that were moved because they overlapped the camera.
    #[must_use]
    pub fn moved_rocks(&self) -> Vec<u32> {
        self.rocks.built().filter(|rock| rock.moved).map(|rock| rock.index).collect()
    }

    /// Hash (XXH3, 128 bits, hexadecimal) of the geometry, on the nominal stage independent of where the camera looks: every vertex of
    /// the ground, dome and stars, which are around the place below the camera, and the rocks ([`Rocks::write_to`]).
    #[must_use]
    pub fn geometry_hash(&self) -> String {
        let mut hasher = XxHash3_128::new();
        self.hash_geometry(|bytes| hasher.write(bytes));
        format!("{:032x}", hasher.finish_128())
    }

    fn hash_geometry(&self, mut write: impl FnMut(&[u8])) {
        write(&self.terrain.columns.to_le_bytes());
        write(bytemuck::cast_slice(&self.terrain.vertices));
        self.rocks.write_to(&mut write);
        write(bytes_of(&self.sky.centre));
        write(&self.sky.radius_m.to_le_bytes());
        for star in &self.sky.stars {
            write(bytes_of(&star.centre));
            write(&star.radius_m.to_le_bytes());
        }
    }
}

/// The rocks of a stage and behind them the parts of the rover that carries a camera at `eye`, if there is one.
fn with_rover(params: &Params, rocks: Rocks, terrain: &Terrain, eye: Vec3) -> Rocks {
    let Some(rover) = Rover::build(params) else { return rocks };
    let view = azimuth::direction(params.number(Knob::CameraYawDeg).to_radians());
    let parts = rover.parts(terrain, eye, view, rocks.len() as u32);
    rocks.with(parts)
}

/// The nominal ground's material: the regolith's tint with the albedo knob as its mean.
fn nominal_regolith(params: &Params) -> Material {
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
    use crate::params::config::Config;

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
