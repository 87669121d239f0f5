//! Frames from the threads of a dataset, measured while as many are begun as are finished.
//!
//! Must not know: what the scenes are.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::measured::{Measured, Setup, Start, WARM_UP, stopped};
use crate::dataset;
use crate::dataset::attempt::Scenes;
use crate::error::Result;
use crate::output::disk;
use crate::render::{FrameCost, Renderer, StageTimes};

/// The measurement of a pipeline, whose frames come from several threads.
struct Pipeline<'a> {
    setup: &'a Setup,
    measured: Measured,
    start: Start,
    last: Instant,
    done: u64,
    /// Frames before the first that is measured: as many as are on the way at a time.
    warm_up: u64,
    /// Whether no further frame is to be started.
    ends: &'a AtomicBool,
}

impl<'a> Pipeline<'a> {
    fn start(setup: &'a Setup, renderer: &Renderer, ends: &'a AtomicBool) -> Self {
        Self::on(setup, renderer.gpu().capabilities.software_adapter, ends)
    }

    fn on(setup: &'a Setup, is_software_adapter: bool, ends: &'a AtomicBool) -> Self {
        let plan = &setup.plan;
        let concurrency = setup.concurrency;
        let frames_in_flight = concurrency.in_flight(is_software_adapter, plan);
        let measured = Measured { frames_in_flight, ..Measured::default() };
        let warm_up = WARM_UP.max(concurrency.in_memory(is_software_adapter, plan) as u64);
        Self { setup, measured, start: Start::now(), last: Instant::now(), done: 0, warm_up, ends }
    }

    /// Number of frames up to the last that is measured.
    fn total(&self) -> u64 {
        self.warm_up + self.setup.frames
    }

    /// Whether every frame is measured; those that come now were on the way at the end.
    fn is_measured(&self) -> bool {
        self.done >= self.total()
    }

    /// A frame is finished.
    fn add(&mut self, times: StageTimes, redraws: u32, cost: &FrameCost) {
        if self.is_measured() {
            return;
        }
        self.done += 1;
        if self.done <= self.warm_up {
            self.start = Start::now();
        } else {
            self.measured.frames_ms.push(self.last.elapsed().as_secs_f64() * 1e3);
            self.measured.stages.push(times);
            self.measured.redraws += u64::from(redraws);
            self.measured.triangles.push(cost.drawn_triangles as f64);
            self.measured.upload_bytes.push(cost.uploaded_bytes as f64);
            self.measured.readback_bytes = cost.readback_bytes;
        }
        self.last = Instant::now();
        if self.is_measured() {
            self.start.end(&mut self.measured);
        }
        if self.is_measured() || self.setup.stop.load(Ordering::Relaxed) {
            self.ends.store(true, Ordering::Relaxed);
        }
    }

    fn end(self, result: Result<()>) -> Result<Measured> {
        if self.is_measured() {
            return Ok(self.measured);
        }
        result.and_then(|()| Err(stopped(self.done, self.total())))
    }
}

/// Measures frames of these scenes, in memory, on the threads of a dataset.
pub(super) fn in_memory(setup: &Setup, renderer: &mut Renderer, scenes: impl Scenes) -> Result<Measured> {
    let ends = AtomicBool::new(false);
    let mut pipeline = Pipeline::start(setup, renderer, &ends);
    let (plan, renderer) = (&setup.plan, Mutex::new(renderer));
    let result =
        dataset::render_in_memory(plan, &renderer, (0.., scenes), setup.concurrency, &ends, |frame| {
            pipeline.add(frame.times, frame.redraws, &frame.cost);
            Ok(())
        });
    pipeline.end(result)
}

/// The same, encoded and written into a folder.
pub(super) fn dataset(setup: &Setup, folder: &Path, renderer: &mut Renderer) -> Result<Measured> {
    let ends = AtomicBool::new(false);
    let mut pipeline = Pipeline::start(setup, renderer, &ends);
    let mut files = disk::FileWriter::new(folder, "bench");
    let result = dataset::render_frames(&setup.plan, renderer, 0.., setup.concurrency, &ends, |frame| {
        if pipeline.is_measured() {
            return Ok(());
        }
        files.write_all(&frame.files.artifacts)?;
        if files.is_sync_due() {
            files.sync_folders()?;
        }
        pipeline.add(frame.times, frame.redraws, &frame.cost);
        Ok(())
    });
    pipeline.end(result)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::dataset::Concurrency;
    use crate::dataset::plan::Plan;
    use crate::dataset::rules::Rules;
    use crate::params::config::Config;
    use crate::render::RenderSettings;

    /// A pipeline of many threads has begun many frames before it finishes one; of few frames these were most.
    #[test]
    fn as_many_frames_are_on_the_way_before_a_measurement_as_at_its_end() {
        let settings = RenderSettings::new([64, 48], 1).expect("settings");
        let plan = Plan::in_memory(Config::new(), Rules::accepting_any_image(), 7, settings, Vec::new());
        let concurrency = Concurrency { threads: Some(16), frames_in_flight: Some(2) };
        let stop = Arc::new(AtomicBool::new(false));
        let setup = Setup { plan, concurrency, frames: 4, stop };
        let ends = AtomicBool::new(false);
        let mut pipeline = Pipeline::on(&setup, false, &ends);
        let on_the_way = 16 + 2 + 1;
        for done in 1..=2 * on_the_way + 4 {
            pipeline.add(StageTimes::new(), 0, &FrameCost::default());
            let is_measured = done >= on_the_way + 4;
            assert_eq!((pipeline.is_measured(), ends.load(Ordering::Relaxed)), (is_measured, is_measured));
        }
        let measured = pipeline.end(Ok(())).expect("measured");
        assert_eq!((measured.frames_ms.len(), measured.stages.len()), (4, 4));
    }

    #[test]
    fn a_stopped_measurement_starts_no_further_frame() {
        let settings = RenderSettings::new([64, 48], 1).expect("settings");
        let plan = Plan::in_memory(Config::new(), Rules::accepting_any_image(), 7, settings, Vec::new());
        let (concurrency, stop) = (Concurrency::default(), Arc::new(AtomicBool::new(true)));
        let setup = Setup { plan, concurrency, frames: 4, stop };
        let ends = AtomicBool::new(false);
        let mut pipeline = Pipeline::on(&setup, true, &ends);
        pipeline.add(StageTimes::new(), 0, &FrameCost::default());
        assert!(ends.load(Ordering::Relaxed));
        assert!(pipeline.end(Ok(())).expect_err("stopped").to_string().contains("stopped: 1 of"));
    }
}
