//! Attempts at a frame: a frame that breaks a rule is rendered again from the next seed.
//!
//! Must not know: threads, files.

use std::time::Instant;

use super::plan::{Plan, frame_seed};
use super::rules::Violation;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::params::Params;
use crate::render::{InFlight, RasterOptions, Renderer, StageTimes, select::selection};
use crate::scene::Scene;

/// The scene of an attempt at a frame.
pub(super) struct FrameScene {
    pub(super) index: u64,
    pub(super) attempt: u32,
    pub(super) seed: u64,
    pub(super) params: Params,
    pub(super) scene: Scene,
    pub(super) times: StageTimes,
    /// The rule that each earlier attempt broke.
    pub(super) redrawn: Vec<String>,
}

/// A rendered frame that keeps the rules.
pub(super) struct RenderedFrame {
    pub(super) source: FrameScene,
    pub(super) frame: Frame,
    pub(super) adapter: wgpu::AdapterInfo,
    pub(super) raster: RasterOptions,
    pub(super) cost: RenderCost,
}

/// What a frame cost the device.
#[derive(Clone, Copy, Debug, Default)]
pub struct RenderCost {
    /// Triangles drawn for the visible surfaces.
    pub triangles: u64,
    /// Bytes uploaded.
    pub uploaded_bytes: u64,
    /// Bytes read back.
    pub readback_bytes: u64,
}

/// Builds the scene of an attempt at a frame.
pub(super) fn build_scene(plan: &Plan, index: u64, attempt: u32, redrawn: Vec<String>) -> Result<FrameScene> {
    let start = Instant::now();
    let seed = frame_seed(plan.base_seed, index, attempt);
    let params = plan.config.draw(seed)?;
    let scene = Scene::build(seed, &params)?;
    selection::build_rocks(&scene, &plan.settings);
    let times = vec![("scene", start.elapsed().as_secs_f64() * 1e3)];
    Ok(FrameScene { index, attempt, seed, params, scene, times, redrawn })
}

/// An attempt at a frame.
pub(super) enum Attempt {
    /// The device is rendering it.
    Submitted(Box<FrameScene>, Box<InFlight>),
    /// Its scene could not be built or submitted.
    Rejected(Violation),
}

impl Attempt {
    /// Submits a scene to the device. A scene that is impossible with these settings counts as a broken rule.
    pub(super) fn submit(plan: &Plan, renderer: &mut Renderer, scene: Result<FrameScene>) -> Result<Self> {
        let submitted = scene.and_then(|scene| {
            let in_flight = renderer.submit(&scene.scene, &plan.settings)?;
            Ok(Self::Submitted(Box::new(scene), Box::new(in_flight)))
        });
        match submitted {
            Ok(attempt) => Ok(attempt),
            Err(Error::Scene(found)) => Ok(Self::Rejected(Violation { rule: "scene".to_owned(), found })),
            Err(other) => Err(other),
        }
    }

    /// Finishes the first attempt at frame `index`, and makes further attempts until one keeps the rules.
    pub(super) fn finish(
        mut self,
        plan: &Plan,
        renderer: &mut Renderer,
        index: u64,
    ) -> Result<RenderedFrame> {
        let (mut attempt, mut redrawn) = (0, Vec::new());
        loop {
            let violation = match self {
                Self::Rejected(violation) => violation,
                Self::Submitted(scene, in_flight) => match read_back(plan, renderer, *scene, *in_flight)? {
                    Ok(rendered) => return Ok(rendered),
                    Err(violation) => violation,
                },
            };
            attempt += 1;
            if attempt == plan.rules.attempts_max {
                return Err(Error::RuleBroken {
                    index,
                    attempts: attempt,
                    rule: violation.rule,
                    found: violation.found,
                });
            }
            redrawn.push(violation.rule);
            self = Self::submit(plan, renderer, build_scene(plan, index, attempt, redrawn.clone()))?;
        }
    }
}

/// Renders one attempt at a frame, whether or not it keeps the rules.
pub(super) fn render_attempt(
    plan: &Plan,
    renderer: &mut Renderer,
    index: u64,
    attempt: u32,
    redrawn: Vec<String>,
) -> Result<RenderedFrame> {
    let source = build_scene(plan, index, attempt, redrawn)?;
    let in_flight = renderer.submit(&source.scene, &plan.settings)?;
    let (frame, _) = renderer.finish(in_flight, &source.scene).map_err(|error| error.of_seed(source.seed))?;
    let (adapter, raster) = (renderer.gpu().info.clone(), renderer.raster());
    Ok(RenderedFrame { source, frame, adapter, raster, cost: RenderCost::default() })
}

/// Waits for a submitted frame, and says which rule it breaks, if any.
fn read_back(
    plan: &Plan,
    renderer: &mut Renderer,
    mut source: FrameScene,
    in_flight: InFlight,
) -> Result<std::result::Result<RenderedFrame, Violation>> {
    let mut cost = RenderCost {
        triangles: in_flight.cost.drawn_triangles,
        uploaded_bytes: in_flight.cost.uploaded_bytes,
        readback_bytes: 0,
    };
    let (frame, times) =
        renderer.finish(in_flight, &source.scene).map_err(|error| error.of_seed(source.seed))?;
    cost.readback_bytes = frame.bytes();
    source.times.extend(times);
    Ok(match plan.rules.violation(&source.scene, &frame) {
        Some(violation) => Err(violation),
        None => Ok(RenderedFrame {
            source,
            frame,
            adapter: renderer.gpu().info.clone(),
            raster: renderer.raster(),
            cost,
        }),
    })
}
