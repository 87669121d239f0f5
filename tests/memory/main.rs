//! What scenes and frames take of memory once there were some. A program of its own, so that nothing else takes any meanwhile.

use std::sync::{Mutex, PoisonError};

use allocation_counter::measure;
use regolith::gpu::Gpu;
use regolith::params::Params;
use regolith::render::select::selection::build_rocks;
use regolith::render::{RenderSettings, Renderer};
use regolith::scene::Scene;

/// Most that lists of what there is may take, whose elements are counted anew for each scene.
const LISTS_BYTES: u64 = 100_000;

/// The same of a frame, with what the driver's interface takes of it.
const FRAME_BYTES: u64 = 700_000;

/// Allocations are counted on the thread that makes them; and one test at a time, as memory is the whole program's.
fn on_one_thread(work: impl FnOnce() + Send) {
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool").install(work);
}

/// Bytes that were taken meanwhile, given back or not.
fn bytes_of<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let mut done = None;
    let taken = measure(|| done = Some(work()));
    (done.expect("it was done"), taken.bytes_total)
}

#[test]
fn a_scene_is_made_in_the_memory_of_those_before_it() {
    on_one_thread(|| {
        let settings = RenderSettings::new([512, 512], 4).expect("settings");
        let build = |seed| {
            let params = Params::draw_default(seed);
            bytes_of(|| {
                let scene = Scene::build(seed, &params).expect("a scene");
                build_rocks(&scene, &settings);
                scene
            })
        };
        assert!(bytes_of(|| vec![1_u8; 1000]).1 >= 1000, "bytes are counted");
        for seed in [1, 2, 3, 4, 5] {
            let (scene, _) = build(seed);
            let vertices = scene.rocks.built().map(|rock| rock.vertices.len()).sum::<usize>();
            assert!(24 * vertices as u64 > 40 * LISTS_BYTES, "seed {seed}: {vertices} vertices");
        }
        for seed in [1, 2, 3, 4, 5] {
            let (_, taken) = build(seed);
            assert!(taken < LISTS_BYTES, "seed {seed}: {taken} bytes");
        }
    });
}

#[test]
fn a_frame_of_a_moving_camera_takes_its_planes_and_lists() {
    on_one_thread(|| {
        let mut renderer = Renderer::new(Gpu::open(Some("cpu")).expect("a device")).expect("a renderer");
        let settings = RenderSettings::new([512, 512], 4).expect("settings");
        let mut scene = Scene::build(1, &Params::draw_default(1)).expect("a scene");
        for frame in 0..10 {
            scene.camera.eye.x += 0.01;
            let ((planes, _), taken) = bytes_of(|| renderer.render(&scene, &settings).expect("a frame"));
            // The first ones make what is kept, and the second compiles programs.
            let is_steady = taken < planes.bytes() + FRAME_BYTES;
            assert!(is_steady || frame < 4, "frame {frame}: {taken} bytes, its planes {}", planes.bytes());
            assert!(!is_steady || frame > 0, "the first has to make what is kept");
        }
    });
}
