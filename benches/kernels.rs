//! The work of the CPU for a frame, kernel by kernel, each with its throughput: `cargo bench`.
//!
//! One thread. The scenes are those of fixed seeds with the default knobs.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use regolith::frame::Frame;
use regolith::gpu::staging::{PAGE_BYTES, Page};
use regolith::output::edges::MaskIds;
use regolith::output::{self, EncodeInput, LabelIds};
use regolith::params::Params;
use regolith::random::Streams;
use regolith::render::lighting::relief_bands::ReliefBands;
use regolith::render::select::caster_grid::CasterCells;
use regolith::render::select::footprint::Footprint;
use regolith::render::select::selection::{SelectedRock, Selection};
use regolith::render::select::tiles::PixelRect;
use regolith::render::shadow::horizon::HorizonMap;
use regolith::render::shadow::host;
use regolith::render::shadow::tiles::{self, ShadowMap};
use regolith::render::visibility::geometry::VisibleTriangles;
use regolith::render::visibility::host::{RowsPart, ShadingBinMask};
use regolith::render::{DEFAULT_TEXTURE_PX, RenderSettings};
use regolith::scene::Scene;
use regolith::scene::mesh::Icosphere;
use regolith::scene::noise::Fbm;
use regolith::scene::sky::Sun;
use regolith::scene::terrain::Terrain;
use serde_json::Value;

const SEED: u64 = 42;

fn noise(c: &mut Criterion) {
    let fbm = Fbm { octaves: 4, frequency: 1.1, lacunarity: 2.05, seed: 7 };
    let Icosphere { directions, axes: [x, y, z], .. } = Icosphere::shared();
    let mut sums = vec![0.0; directions.len()];
    let mut group = c.benchmark_group("noise");
    group.throughput(Throughput::Elements(directions.len() as u64));
    group.bench_function("fbm_3d_many", |b| b.iter(|| fbm.at_many_3d([x, y, z], black_box(&mut sums))));
    group.bench_function("fbm_3d_one_by_one", |b| {
        b.iter(|| directions.iter().map(|d| fbm.at_3d((*d).into())).sum::<f32>());
    });
    group.finish();
}

fn geometry(c: &mut Criterion) {
    let (streams, params) = (Streams::new(SEED), Params::draw_default(SEED));
    let terrain = Arc::new(Terrain::build(&streams, &params));
    let scene = Scene::build(SEED, &params).expect("the scene of the seed");
    let mut group = c.benchmark_group("geometry");
    group.throughput(Throughput::Elements(terrain.vertices.len() as u64));
    group.bench_function("terrain", |b| b.iter(|| Terrain::build(&streams, black_box(&params))));
    let vertices: usize = scene.rocks.iter().map(|rock| rock.vertices.len()).sum();
    group.throughput(Throughput::Elements(vertices as u64));
    group.bench_function("rocks", |b| {
        let eye = scene.camera.eye;
        b.iter(|| regolith::scene::rocks::plan(&streams, black_box(&params), &terrain, eye).iter().count());
    });
    let rock = scene.rocks.iter().max_by_key(|rock| rock.level).expect("a rock");
    group.throughput(Throughput::Elements(rock.vertices.len() as u64));
    group.bench_function("normals", |b| {
        let copy = || rock.vertices.to_vec();
        b.iter_batched_ref(
            copy,
            |v| Icosphere::shared().set_smooth_normals(v, rock.level),
            BatchSize::SmallInput,
        );
    });
    group.throughput(Throughput::Elements((terrain.vertices.len() + vertices) as u64));
    group.bench_function("scene", |b| b.iter(|| Scene::build(black_box(SEED), &params)));
    group.finish();
}

/// Everything that the host computes for a frame of a scene before the upload.
fn frame_plan(c: &mut Criterion) {
    let scene = Scene::build(SEED, &Params::draw_default(SEED)).expect("the scene of the seed");
    let settings = RenderSettings::new([512, 512], 4).expect("settings");
    let selection = Selection::new(&scene, &settings);
    let footprint = Footprint::new(&scene, &selection);
    let mut horizon = HorizonMap::default();
    horizon.compute(&scene.terrain, &scene.sun, &footprint, DEFAULT_TEXTURE_PX);
    let grid = CasterCells::new(&scene, &selection.casters, &footprint)
        .expect("lists")
        .grid(horizon.shadowed_ground());
    let bands = ReliefBands::new(&scene, &selection, &settings);
    let (mut visible, mut stencil) = (VisibleTriangles::default(), ShadingBinMask::default());
    let mut later = scene.clone();
    let Sun { elevation_deg, azimuth_deg, angular_diameter_deg, irradiance, .. } = scene.sun;
    later.sun = Sun::new(elevation_deg, azimuth_deg + 1.0, angular_diameter_deg, irradiance);
    let mut group = c.benchmark_group("frame");
    group.bench_function("selection", |b| b.iter(|| Selection::new(black_box(&scene), &settings)));
    group.throughput(Throughput::Elements(horizon.heights_m.len() as u64));
    group.bench_function("horizon_map", |b| {
        // The map is computed again only when the sun has moved.
        let (mut map, mut suns) = (HorizonMap::default(), [&scene.sun, &later.sun].into_iter().cycle());
        b.iter(|| {
            map.compute(
                &scene.terrain,
                black_box(suns.next().unwrap_or(&scene.sun)),
                &footprint,
                DEFAULT_TEXTURE_PX,
            )
        });
    });
    group.throughput(Throughput::Elements(selection.casters.len() as u64));
    group.bench_function("caster_grid", |b| {
        b.iter(|| {
            CasterCells::new(black_box(&scene), &selection.casters, &footprint)
                .expect("lists")
                .grid(horizon.shadowed_ground())
        });
    });
    let cast = |rock: &SelectedRock| {
        rock.caster.map_or(0, |(_, level)| scene.rocks[rock.rock].triangles(level).len())
    };
    group.throughput(Throughput::Elements(selection.rocks.iter().map(cast).sum::<usize>() as u64));
    group.bench_function("shadow_map", |b| {
        let tiles = ShadowMap::default().allocate(&scene, &mut selection.clone(), DEFAULT_TEXTURE_PX);
        let bands = tiles::bands(&tiles);
        let mut room = vec![[0; PAGE_BYTES]; tiles::upload_regions(&bands).1 / PAGE_BYTES];
        b.iter(|| host::rasterise(black_box(&scene), &bands, &mut room.iter_mut().map(Page::from_mut)));
    });
    visible.find(&scene, &selection, &settings, &grid, &bands, true);
    let triangles = visible.meshes().iter().map(|mesh| mesh.triangles.len()).sum::<usize>();
    group.throughput(Throughput::Elements(triangles as u64));
    group.bench_function("visible_triangles", |b| {
        b.iter(|| visible.find(black_box(&scene), &selection, &settings, &grid, &bands, true));
    });
    let [width, height] = settings.sample_size();
    let samples = PixelRect::whole([width, height]);
    let part = RowsPart { image_width: width as usize, samples, rows: 0..height, uploaded: 0..0 };
    group.throughput(Throughput::Elements(u64::from(width) * u64::from(height)));
    group.bench_function("visibility", |b| {
        b.iter(|| {
            stencil.restart([width, height]);
            let nowhere = (&mut std::iter::empty() as &mut dyn Iterator<Item = _>, [0; 2]);
            stencil.draw(black_box(&visible), &part, nowhere);
        });
    });
    group.finish();
}

/// A synthetic frame that compresses like a real one: a horizon, coarse grain, patches of rock.
fn frame(side: u32) -> Frame {
    let grain = Fbm { octaves: 5, frequency: 0.05, lacunarity: 2.0, seed: 3 };
    let mut frame = Frame { width: side, height: side, ..Frame::default() };
    for y in 0..side {
        for x in 0..side {
            let value = grain.at_2d([x as f32, y as f32]);
            let sky = 3 * y < side;
            let grey = if sky { 0 } else { (110.0 + 90.0 * value) as u8 };
            frame.rgb.extend([grey, grey, grey.saturating_sub(4)]);
            frame.class.push(if sky { 2 } else { u8::from(value > 0.3) });
        }
    }
    frame
}

fn encode(c: &mut Criterion) {
    let frame = frame(512);
    let source = EncodeInput {
        frame: &frame,
        meta: &Value::Null,
        label_ids: LabelIds::Canonical,
        mask: &MaskIds::default(),
    };
    let mut group = c.benchmark_group("encode");
    for (name, bytes) in [("rgb", frame.rgb.len()), ("mask", frame.class.len())] {
        let outputs = output::parse_outputs(name).expect("a known output");
        group.throughput(Throughput::Bytes(bytes as u64));
        group.bench_function(name, |b| b.iter(|| output::encode(black_box(&source), &outputs)));
    }
    group.finish();
}

/// Runs everything on one thread, so that results do not depend on the number of cores.
fn on_one_thread(_: &mut Criterion) {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()
        .expect("the first pool");
}

criterion_group!(benches, on_one_thread, noise, geometry, frame_plan, encode);
criterion_main!(benches);
