//! A scene that is built once and rendered from many poses.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use regolith::dataset::attempt::BuiltScene;
use regolith::dataset::frame_stream::render_scene;
use regolith::dataset::plan::Plan;
use regolith::dataset::pose::Pose;
use regolith::dataset::{FrameStream, cores};
use regolith::export::{self, Detail, Format, Stage};
use regolith::output::{Artifact, disk};

use crate::convert::{self, PyFrame};
use crate::engine::{Engine, Frames};
use crate::errors::{raised, refused};

/// A scene with the values of its knobs.
#[pyclass(frozen)]
pub(crate) struct Scene {
    plan: Plan,
    built: BuiltScene,
}

impl Scene {
    pub(crate) fn new(plan: Plan, built: BuiltScene) -> Self {
        Self { plan, built }
    }

    /// The bytes of a file of this format.
    fn encoded(&self, format: Format, drawn: bool) -> regolith::Result<Vec<u8>> {
        let BuiltScene { seed, scene, params } = &self.built;
        let knobs = params.to_json();
        let detail = if drawn { Detail::Drawn } else { Detail::Authored };
        let stage = Stage { scene, seed: *seed, knobs: &knobs, settings: &self.plan.settings, detail };
        // A pool of its own: the threads of the common pool do not exist in a process that was forked.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(cores()).build();
        let pool = pool.map_err(|error| regolith::Error::Thread(std::io::Error::other(error)))?;
        pool.install(|| export::export(&stage, format))
    }
}

#[pymethods]
impl Scene {
    /// A frame; `set` is TOML of knobs of camera and sun that differ from those of the scene.
    fn render<'py>(
        &self,
        py: Python<'py>,
        engine: &Engine,
        set: &str,
        eye_z_m: Option<f32>,
    ) -> PyResult<PyFrame<'py>> {
        let frame = engine.on_pool(py, |renderer| {
            let pose = Pose::new(&self.plan, &self.built, set, eye_z_m)?;
            render_scene(&self.plan, renderer, pose.in_scene(&self.built, &self.plan.settings)?.0)
        });
        convert::frame(py, frame?)
    }

    /// Frames from these poses, each as in `render`.
    fn frames(
        &self,
        py: Python<'_>,
        engine: &Engine,
        poses: Vec<(String, Option<f32>)>,
        prefetch: usize,
    ) -> PyResult<Frames> {
        let checked = poses.iter().map(|(set, eye_z_m)| Pose::new(&self.plan, &self.built, set, *eye_z_m));
        let poses: Vec<Pose> = raised(py, checked.collect())?;
        engine.stream(py, |renderer, concurrency| {
            let of_scene = (self.built.clone(), poses);
            FrameStream::of_poses(self.plan.clone(), renderer, of_scene, concurrency, prefetch)
        })
    }

    /// Height of the ground at a point, metres.
    fn ground_height(&self, x_m: f32, y_m: f32) -> f32 {
        self.built.scene.terrain.height_at([x_m, y_m].into())
    }

    /// The scene as an npz file.
    fn npz<'py>(&self, py: Python<'py>, drawn: bool) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = py.detach(|| self.encoded(Format::Npz, drawn));
        Ok(PyBytes::new(py, &raised(py, bytes)?))
    }

    /// Writes the scene to a file, completely or not at all; the extension selects the format.
    fn export(&self, py: Python<'_>, path: PathBuf, drawn: bool) -> PyResult<()> {
        let refused = |allowed: &str| refused(py, "path", &path.display().to_string(), allowed, None);
        let format = Format::from_path(&path).map_err(|_| {
            let extensions = Format::ALL.map(|(_, extension)| format!(".{extension}"));
            refused(&format!("names that end in {}", extensions.join(", ")))
        })?;
        let name = path.file_name().and_then(OsStr::to_str);
        let name = name.ok_or_else(|| refused("names of files that are text in UTF-8"))?.to_owned();
        let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let written = py.detach(|| {
            let bytes = self.encoded(format, drawn)?;
            disk::write_all(folder, &[Artifact { name, bytes }])
        });
        raised(py, written).map(drop)
    }
}
