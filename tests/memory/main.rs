//! Memory that scenes and frames allocate once buffers of earlier ones can be reused. A binary of its own, so that no other test
//! allocates at the same time.

#[path = "../suite/support/adapter.rs"]
mod adapter;

use std::sync::{Mutex, PoisonError};

use allocation_counter::measure;
use regolith::gpu::Gpu;
use regolith::params::Params;
use regolith::params::config::Config;
use regolith::render::select::selection::build_rocks;
use regolith::render::{RasterMode, RenderSettings, Renderer};
use regolith::scene::Scene;

use adapter::adapter;

/// Largest allocation for lists whose length differs from scene to scene, bytes.
const MAX_LISTS_BYTES: u64 = 100_000;

/// Largest allocation for a frame besides its planes, with that of the driver's interface, bytes.
const MAX_FRAME_BYTES: u64 = 700_000;

/// Largest growth in 15 frames of different scenes, bytes.
const MAX_ADDED_BYTES: i64 = 20_000_000;

/// Runs `work` on one thread, as allocations are counted per thread, and one test at a time, as memory is shared.
fn on_one_thread(work: impl FnOnce() + Send) {
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool").install(work);
}

/// The result of `work` and the bytes that it allocates, freed again or not.
fn bytes_of<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let mut result = None;
    let allocated = measure(|| result = Some(work()));
    (result.expect("the work ran"), allocated.bytes_total)
}

#[test]
fn a_scene_reuses_the_memory_of_earlier_scenes() {
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
            assert!(24 * vertices as u64 > 40 * MAX_LISTS_BYTES, "seed {seed}: {vertices} vertices");
        }
        for seed in [1, 2, 3, 4, 5] {
            let (_, allocated) = build(seed);
            assert!(allocated < MAX_LISTS_BYTES, "seed {seed}: {allocated} bytes");
        }
    });
}

/// The sizes of meshes, lists and tiles differ from scene to scene. What is kept of one must serve the next.
#[test]
fn memory_does_not_grow_with_the_number_of_scenes() {
    on_one_thread(|| {
        let mut renderer = Renderer::new(Gpu::open(Some(&adapter())).expect("a device")).expect("a renderer");
        let settings = RenderSettings::new([96, 72], 1).expect("settings");
        let mut render = |seeds: std::ops::Range<u64>| {
            measure(|| {
                for seed in seeds {
                    let mut config = Config::new();
                    config.apply_preset("surface_train_full").expect("a preset");
                    let params = config.draw(seed).expect("parameters");
                    let scene = Scene::build(seed, &params).expect("a scene");
                    renderer.render(&scene, &settings).expect("a frame");
                }
            })
            .bytes_current
        };
        render(0..10);
        let added = render(10..25);
        assert!(added < MAX_ADDED_BYTES, "{added} bytes in 15 frames");
    });
}

#[test]
fn a_frame_of_a_moving_camera_allocates_only_its_planes_and_lists() {
    on_one_thread(|| {
        // Compute passes, as on GPUs, take a CPU driver long.
        for (mode, side, frames) in [(RasterMode::Auto, 512, 10), (RasterMode::Compute, 96, 6)] {
            let gpu = Gpu::open(Some(&adapter())).expect("a device");
            let mut renderer = Renderer::with_raster(gpu, mode).expect("a renderer");
            let settings = RenderSettings::new([side; 2], 4).expect("settings");
            let mut scene = Scene::build(1, &Params::draw_default(1)).expect("a scene");
            for frame in 0..frames {
                scene.camera.eye.x += 0.01;
                let ((planes, _), allocated) =
                    bytes_of(|| renderer.render(&scene, &settings).expect("a frame"));
                // The first frames allocate what is reused later, and the second compiles pipelines.
                let is_steady = allocated < planes.bytes() + MAX_FRAME_BYTES;
                assert!(
                    is_steady || frame < 4,
                    "{mode}, frame {frame}: {allocated} bytes, its planes {}",
                    planes.bytes()
                );
                assert!(!is_steady || frame > 0, "the first frame has to allocate what is reused");
            }
        }
    });
}
