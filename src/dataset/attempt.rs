//! Attempts at a frame: a frame that breaks a rule is rendered again from the next seed.
//!
//! Must not know: threads, files.

use std::borrow::BorrowMut;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::plan::{Plan, Seeds};
use super::rules::Violation;
use crate::error::{Error, Result};
use crate::frame::Frame;
use crate::output::edges::MaskIds;
use crate::params::Params;
use crate::render::{
    FrameCost, FramePacket, FramePlanner, RasterOptions, RawFrame, RenderSettings, Renderer, StageTimes,
    Staging, select::selection,
};
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

/// A scene, and what it was built from.
#[derive(Clone, Debug)]
pub struct BuiltScene {
    /// Its seed.
    pub seed: u64,
    /// The scene.
    pub scene: Scene,
    /// The values of its knobs.
    pub params: Params,
}

impl BuiltScene {
    /// Builds a scene with the rocks that a frame of it may need.
    ///
    /// # Errors
    /// Those of [`Scene::build`].
    pub fn new(seed: u64, params: Params, settings: &RenderSettings) -> Result<Self> {
        let scene = Scene::build(seed, &params)?;
        selection::build_rocks(&scene, settings);
        Ok(Self { seed, scene, params })
    }

    /// Builds the same scene for another camera, that of `params`.
    ///
    /// # Errors
    /// Those of [`Scene::build`].
    pub(super) fn for_pose(&self, params: Params, settings: &RenderSettings) -> Result<Self> {
        let scene = Scene::build_for_pose(self.seed, &params, &self.params)?;
        selection::build_rocks(&scene, settings);
        Ok(Self { seed: self.seed, scene, params })
    }
}

/// Where the scenes of a plan's frames come from: that of an attempt at a frame, by the frame's index and the number of the attempt, and
/// what of it is to be staged.
pub trait Scenes: Fn(&Plan, u64, u32) -> Result<(BuiltScene, Staging)> + Sync {}

impl<F: Fn(&Plan, u64, u32) -> Result<(BuiltScene, Staging)> + Sync> Scenes for F {}

/// The scene of an attempt's seed. It is a [`Scenes`].
///
/// # Errors
/// Those of [`build_scene`].
pub fn scene_of_seed(plan: &Plan, index: u64, attempt: u32) -> Result<(BuiltScene, Staging)> {
    Ok((build_scene(plan, plan.seed_of(index, attempt))?, Staging::Whole))
}

/// A rendered frame that keeps the rules.
pub struct RenderedFrame {
    pub(super) source: FrameScene,
    pub(super) frame: Frame,
    /// The frame's mask as it is written.
    pub(super) mask: MaskIds,
    pub(super) adapter: wgpu::AdapterInfo,
    pub(super) raster: RasterOptions,
    pub(super) cost: FrameCost,
}

impl RenderedFrame {
    /// Its number in the dataset.
    pub(super) const fn index(&self) -> u64 {
        self.source.index
    }
}

/// Adapter and options of the renderer that draws a dataset.
pub(super) struct RendererInfo {
    pub(super) adapter: wgpu::AdapterInfo,
    pub(super) raster: RasterOptions,
}

impl RendererInfo {
    pub(super) fn new(renderer: &Renderer) -> Self {
        Self { adapter: renderer.gpu().info.clone(), raster: renderer.raster() }
    }
}

/// The renderer, for one step of a frame. A panic while it was locked is an error of the device, which the renderer reports itself.
pub(super) fn lock<R>(renderer: &Mutex<R>) -> MutexGuard<'_, R> {
    renderer.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What workers need of a renderer that others use meanwhile.
pub(super) fn planner_and_info(
    renderer: &Mutex<impl BorrowMut<Renderer>>,
) -> (Arc<FramePlanner>, RendererInfo) {
    let renderer = lock(renderer);
    let renderer: &Renderer = (*renderer).borrow();
    (renderer.planner(), RendererInfo::new(renderer))
}

/// An attempt that is to be made.
#[derive(Debug)]
pub(super) struct Attempt {
    /// Of the frame.
    pub(super) index: u64,
    /// How many were made before it.
    number: u32,
    /// The rule that each of them broke.
    redrawn: Vec<String>,
}

impl Attempt {
    /// The first attempt at a frame.
    pub(super) const fn first(index: u64) -> Self {
        Self { index, number: 0, redrawn: Vec::new() }
    }

    /// An attempt of a known number, and the rules that those before it broke.
    pub(super) const fn known(index: u64, number: u32, redrawn: Vec<String>) -> Self {
        Self { index, number, redrawn }
    }

    /// Whether attempts were made before it.
    pub(super) const fn is_redraw(&self) -> bool {
        self.number > 0
    }

    /// The attempt that follows one which broke a rule.
    ///
    /// # Errors
    /// [`Error::RuleBroken`] if that was the last one allowed.
    fn next(
        index: u64,
        number: u32,
        mut redrawn: Vec<String>,
        violation: Violation,
        plan: &Plan,
    ) -> Result<Self> {
        let attempts = number + 1;
        if attempts == plan.rules.attempts_max {
            let Violation { rule, value, found } = violation;
            return Err(Error::RuleBroken { index, attempts, rule, value, found });
        }
        redrawn.push(violation.rule);
        Ok(Self { index, number: attempts, redrawn })
    }

    /// Builds the scene of the attempt and plans its frame. A scene that is impossible with these settings, or that breaks a rule
    /// whatever its frame shows, is never rendered: the next attempt is made.
    ///
    /// # Errors
    /// [`Error::RuleBroken`] if that was the last one allowed.
    pub(super) fn prepare(
        mut self,
        plan: &Plan,
        planner: &FramePlanner,
        scenes: &impl Scenes,
    ) -> Result<PreparedAttempt> {
        loop {
            let prepared = prepare(plan, planner, scenes, &self);
            let Self { index, number, redrawn } = self;
            let violation = match prepared {
                Err(Error::Scene(found)) if plan.seeds == Seeds::OfBase => {
                    Violation { rule: "scene".to_owned(), value: None, found }
                }
                Err(error) => return Err(error),
                Ok(prepared) => match plan.violation_of_scene(&prepared.source.scene) {
                    Some(violation) => violation,
                    None => return Ok(prepared),
                },
            };
            self = Self::next(index, number, redrawn, violation, plan)?;
        }
    }
}

/// An attempt that is ready for the device.
pub(super) struct PreparedAttempt {
    pub(super) source: FrameScene,
    pub(super) packet: FramePacket,
}

/// An attempt that was rendered and read back.
pub(super) struct RawAttempt {
    pub(super) source: FrameScene,
    pub(super) raw: RawFrame,
    pub(super) cost: FrameCost,
}

impl RawAttempt {
    /// Post-processes the frame.
    fn post_process(self, plan: &Plan, renderer: &RendererInfo) -> RenderedFrame {
        let Self { mut source, raw, cost } = self;
        let (frame, times) = raw.post_process(&source.scene);
        source.times.extend(times);
        let RendererInfo { adapter, raster } = renderer;
        let mask = MaskIds::new(plan.edges);
        RenderedFrame { source, frame, mask, adapter: adapter.clone(), raster: *raster, cost }
    }

    /// Post-processes the frame, and returns the next attempt instead of it if it breaks a rule.
    ///
    /// # Errors
    /// [`Error::RuleBroken`] if it was the last one allowed.
    pub(super) fn check(
        self,
        plan: &Plan,
        renderer: &RendererInfo,
    ) -> Result<std::result::Result<RenderedFrame, Attempt>> {
        let rendered = self.post_process(plan, renderer);
        let source = &rendered.source;
        match plan.violation(&source.scene, &rendered.frame, &rendered.mask) {
            None => Ok(Ok(rendered)),
            Some(violation) => {
                let FrameScene { index, attempt, redrawn, .. } = rendered.source;
                Ok(Err(Attempt::next(index, attempt, redrawn, violation, plan)?))
            }
        }
    }
}

/// Builds the scene of a seed with a plan's knobs.
///
/// # Errors
/// Those of [`Config::draw`](crate::params::config::Config::draw) and [`Scene::build`].
pub fn build_scene(plan: &Plan, seed: u64) -> Result<BuiltScene> {
    BuiltScene::new(seed, plan.config.draw(seed)?, &plan.settings)
}

/// Builds the scene of an attempt and plans its frame.
fn prepare(
    plan: &Plan,
    planner: &FramePlanner,
    scenes: &impl Scenes,
    attempt: &Attempt,
) -> Result<PreparedAttempt> {
    let start = Instant::now();
    let &Attempt { index, number, ref redrawn } = attempt;
    let (BuiltScene { seed, scene, params }, staging) = scenes(plan, index, number)?;
    let times = vec![("scene", start.elapsed().as_secs_f64() * 1e3)];
    let packet = planner.plan_and_stage(&scene, &plan.settings, staging)?;
    let redrawn = redrawn.clone();
    let source = FrameScene { index, attempt: number, seed, params, scene, times, redrawn };
    Ok(PreparedAttempt { source, packet })
}

/// Renders a scene that is built already, whatever rules say, and waits for it.
pub(super) fn render_scene(
    plan: &Plan,
    renderer: &Mutex<impl BorrowMut<Renderer>>,
    source: FrameScene,
) -> Result<RenderedFrame> {
    let (planner, info) = planner_and_info(renderer);
    let packet = planner.plan(&source.scene, &plan.settings)?;
    let raw = render((*lock(renderer)).borrow_mut(), PreparedAttempt { source, packet })?;
    Ok(raw.post_process(plan, &info))
}

/// Renders one attempt at a frame and waits for it.
fn render(renderer: &mut Renderer, prepared: PreparedAttempt) -> Result<RawAttempt> {
    let PreparedAttempt { source, packet } = prepared;
    let in_flight = renderer.submit_packet(&source.scene, packet)?;
    let cost = in_flight.cost;
    let raw = renderer.read_back(in_flight).map_err(|error| error.of_seed(source.seed))?;
    Ok(RawAttempt { source, raw, cost })
}

/// Renders one attempt at a frame, whether or not it keeps the rules.
pub(super) fn render_attempt(
    plan: &Plan,
    renderer: &mut Renderer,
    attempt: &Attempt,
) -> Result<RenderedFrame> {
    let prepared = prepare(plan, &renderer.planner(), &scene_of_seed, attempt)?;
    Ok(render(renderer, prepared)?.post_process(plan, &RendererInfo::new(renderer)))
}

/// Renders a frame as a dataset has it: the first attempt that keeps the rules.
pub(super) fn render_frame(plan: &Plan, renderer: &mut Renderer, index: u64) -> Result<RenderedFrame> {
    let (planner, info) = (renderer.planner(), RendererInfo::new(renderer));
    let mut attempt = Attempt::first(index);
    loop {
        let prepared = attempt.prepare(plan, &planner, &scene_of_seed)?;
        match render(renderer, prepared)?.check(plan, &info)? {
            Ok(rendered) => return Ok(rendered),
            Err(next) => attempt = next,
        }
    }
}
