//! What is to be measured, and what was.
//!
//! Must not know: which cases there are.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use serde_json::{Map, Value, json};

use crate::dataset::Concurrency;
use crate::dataset::plan::Plan;
use crate::error::Error;
use crate::host_time::{self, Role, RoleTimes};
use crate::render::{FRAMES_IN_FLIGHT, StageTimes};

/// Least number of frames before the measurement starts.
pub(super) const WARM_UP: u64 = 3;

/// The measurements of a case.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Milliseconds from the end of one frame to that of the next.
    pub frames_ms: Vec<f64>,
    /// Milliseconds from the start of the first frame to the end of the last.
    pub total_ms: f64,
    /// Mean processor time of the program's own threads for a frame, by what they do; `None` where the system does not report it.
    pub host: Option<RoleTimes>,
    /// Processor time of the whole process for a frame, a driver's threads included, milliseconds; `None` where the system does not
    /// report it.
    pub process_ms: Option<f64>,
    /// Attempts that broke a rule, in the cases on the threads of a dataset.
    pub redraws: u64,
    /// Frames that the device worked on at a time.
    pub frames_in_flight: usize,
    /// Peak resident memory of the process up to the end of the case, bytes.
    pub peak_rss_bytes: Option<u64>,
    /// Milliseconds of work by stage, of each frame.
    pub stages: Vec<StageTimes>,
    /// Triangles drawn for visibility, of each frame.
    pub triangles: Vec<f64>,
    /// Bytes uploaded to the device, of each frame.
    pub upload_bytes: Vec<f64>,
    /// Bytes read back for each frame.
    pub readback_bytes: u64,
}

/// The quantile `q` of the values by the nearest rank, without interpolation: the least value that this fraction of them does not exceed; 0 for
/// an empty list.
#[must_use]
pub fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (sorted.len() as f64 * q).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or_default()
}

impl Measured {
    /// Frames per second over the whole case.
    #[must_use]
    pub fn frames_per_second(&self) -> f64 {
        1e3 * self.frames_ms.len() as f64 / self.total_ms.max(1e-9)
    }

    /// Mean processor time of the program's own threads for a frame, milliseconds.
    #[must_use]
    pub fn host_ms(&self) -> Option<f64> {
        self.host.map(|host| host.total())
    }

    /// A model of the throughput on a number of cores, frames per second, as far as the host limits it: no thread that exists once
    /// does more than its share of every frame, and all cores together do all of the work.
    #[must_use]
    pub fn host_frames_per_second(&self, cores: usize) -> Option<f64> {
        let host = self.host?;
        let serial_ms = host.of(Role::Device).max(host.of(Role::Writer));
        Some(1e3 / serial_ms.max(host.total() / cores as f64).max(1e-9))
    }

    /// Median milliseconds of each stage, in the order of execution; a frame without a stage, such as that of a sensor, takes none for it.
    #[must_use]
    pub fn stage_ms(&self) -> StageTimes {
        let mut names: Vec<&'static str> = Vec::new();
        for stages in &self.stages {
            let mut after = 0;
            for (name, _) in stages {
                after = names.iter().position(|known| known == name).unwrap_or_else(|| {
                    names.insert(after, name);
                    after
                }) + 1;
            }
        }
        let median = |name| {
            let of = |stages: &StageTimes| {
                stages.iter().find(|stage| stage.0 == name).map_or(0.0, |stage| stage.1)
            };
            quantile(&self.stages.iter().map(of).collect::<Vec<_>>(), 0.5)
        };
        names.into_iter().map(|name| (name, median(name))).collect()
    }

    /// The entry of the case in `bench --json`.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let stages: Map<String, Value> =
            self.stage_ms().into_iter().map(|(name, ms)| (name.to_owned(), ms.into())).collect();
        json!({
            "frames": self.frames_ms.len(),
            "median_ms": quantile(&self.frames_ms, 0.5),
            "p95_ms": quantile(&self.frames_ms, 0.95),
            "frames_per_second": self.frames_per_second(),
            "process_ms": self.process_ms,
            "redraws": self.redraws,
            "frames_in_flight": self.frames_in_flight,
            "peak_rss_bytes": self.peak_rss_bytes,
            "host_ms": self.host_ms(),
            "host_thread_ms": self.host.map(|host| json!({
                "device": host.of(Role::Device),
                "writer": host.of(Role::Writer),
                "workers": host.of(Role::Worker) + host.of(Role::Pool),
            })),
            "host_frames_per_second_16_cores": self.host_frames_per_second(16),
            "stage_ms": stages,
            "triangles": quantile(&self.triangles, 0.5) as u64,
            "upload_bytes": quantile(&self.upload_bytes, 0.5) as u64,
            "readback_bytes": self.readback_bytes,
        })
    }
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Knobs, seed, size, samples and outputs; its range, splits and shard are not used.
    pub plan: Plan,
    /// Frames in flight, and the threads of the case `dataset`.
    pub concurrency: Concurrency,
    /// Number of frames after the warm-up.
    pub frames: u64,
    /// Once it is true, no further frame is measured.
    pub stop: Arc<AtomicBool>,
}

impl Setup {
    /// Frames that the device works on at a time in the cases whose scenes come from one thread.
    pub(super) fn frames_in_flight(&self) -> usize {
        self.concurrency.frames_in_flight.unwrap_or(FRAMES_IN_FLIGHT)
    }
}

/// The error of a measurement that was stopped.
pub(super) const fn stopped(done: u64, wanted: u64) -> Error {
    Error::Stopped { done, wanted, remedy: "A measurement cannot be resumed; run it again" }
}

/// Starts the measurement of a case.
#[derive(Clone, Copy)]
pub(super) struct Start {
    at: Instant,
    host: Option<RoleTimes>,
    process_ms: Option<f64>,
}

impl Start {
    /// The start is now.
    pub(super) fn now() -> Self {
        Self { at: Instant::now(), host: host_time::by_role(), process_ms: host_time::of_process_ms() }
    }

    /// Sets the times from the start to now.
    pub(super) fn end(self, measured: &mut Measured) {
        measured.total_ms = self.at.elapsed().as_secs_f64() * 1e3;
        let frames = measured.frames_ms.len().max(1) as f64;
        let process_ms = host_time::of_process_ms().zip(self.process_ms);
        measured.process_ms = process_ms.map(|(end, start)| (end - start) / frames);
        measured.peak_rss_bytes = peak_rss_bytes();
        let host = host_time::by_role().zip(self.host);
        measured.host = host.map(|(end, start)| end.since(&start, measured.frames_ms.len()));
    }
}

/// Peak resident memory of this process, bytes; `None` where the system does not report it.
#[must_use]
pub fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(1024 * line.split_whitespace().nth(1)?.parse::<u64>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_the_nearest_ranks() {
        let to = |n: u32| (1..=n).rev().map(f64::from).collect::<Vec<_>>();
        assert_eq!(
            [quantile(&to(20), 0.95), quantile(&to(20), 0.5), quantile(&to(5), 0.5)],
            [19.0, 10.0, 3.0]
        );
        assert_eq!([quantile(&to(1), 0.95), quantile(&to(3), 1.0), quantile(&[], 0.5)], [1.0, 3.0, 0.0]);
    }

    #[test]
    fn a_stage_that_few_frames_have_is_named_and_takes_the_others_no_time() {
        let with = vec![("scene", 1.0), ("sensor", 8.0), ("encode", 2.0)];
        let without = vec![("scene", 3.0), ("encode", 4.0)];
        for (stages, sensor_ms) in
            [([without.clone(), with.clone(), without], 0.0), ([with.clone(), with.clone(), with], 8.0)]
        {
            let found = Measured { stages: stages.to_vec(), ..Measured::default() }.stage_ms();
            assert_eq!(found.iter().map(|stage| stage.0).collect::<Vec<_>>(), ["scene", "sensor", "encode"]);
            assert_eq!(found[1].1, sensor_ms);
        }
    }

    #[test]
    fn the_model_of_the_host_is_limited_by_its_serial_threads_or_by_its_cores() {
        assert_eq!(Measured::default().host_frames_per_second(16), None);
        let measured = |device, worker, writer| Measured {
            host: Some(RoleTimes::new(device, worker, writer)),
            ..Measured::default()
        };
        for (times, cores, expected) in
            [((1.0, 30.0, 0.5), 16, 508.0), ((1.0, 30.0, 0.5), 64, 1000.0), ((1.0, 30.0, 4.0), 64, 250.0)]
        {
            let found = measured(times.0, times.1, times.2).host_frames_per_second(cores).expect("a model");
            assert!((found - expected).abs() < 1.0, "{found}, not {expected}");
        }
    }
}
