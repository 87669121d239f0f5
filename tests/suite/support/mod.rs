//! Helpers that the tests share: the renderer, scenes, the command line as a process.

mod adapter;
pub(crate) mod compare;
pub(crate) mod source;

use std::path::Path;
use std::process::{Child, Command, Output};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

use regolith::frame::Frame;
use regolith::gpu::Gpu;
use regolith::params::Params;
use regolith::params::config::Config;
use regolith::render::{RasterMode, RenderSettings, Renderer};
use regolith::scene::Scene;

pub(crate) use adapter::adapter;

/// A renderer on the adapter of the tests, shared by all tests. Without a driver every test that renders fails with the message that a
/// user would get: what is missing and how to install it.
pub(crate) fn renderer() -> MutexGuard<'static, Renderer> {
    static RENDERER: LazyLock<Mutex<Renderer>> = LazyLock::new(|| open(RasterMode::Auto));
    RENDERER.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the GL driver of the adapter of the tests lacks: NVIDIA's, for one, the version.
pub(crate) fn missing_gl() -> Vec<String> {
    let adapters = regolith::gpu::survey::survey().expect("adapters");
    let of_gl = adapters.into_iter().find(|found| found.backend == "gl" && found.matches(&adapter()));
    of_gl.expect("a GL driver").missing
}

/// The name of the adapter of the tests, as its driver reports it.
pub(crate) fn adapter_name() -> String {
    renderer().gpu().info.name.clone()
}

/// The raster backends: whatever is asserted of a frame holds for all.
pub(crate) const BACKENDS: [RasterMode; 3] = [RasterMode::Host, RasterMode::Device, RasterMode::Compute];

/// A renderer that rasterises by a backend, shared by all tests.
pub(crate) fn renderer_by(backend: RasterMode) -> MutexGuard<'static, Renderer> {
    static RENDERERS: [LazyLock<Mutex<Renderer>>; 3] = [
        LazyLock::new(|| open(RasterMode::Host)),
        LazyLock::new(|| open(RasterMode::Device)),
        LazyLock::new(|| open(RasterMode::Compute)),
    ];
    let index = BACKENDS.iter().position(|mode| *mode == backend).expect("a backend");
    RENDERERS[index].lock().unwrap_or_else(PoisonError::into_inner)
}

/// A frame by a raster backend.
pub(crate) fn render_by(backend: RasterMode, scene: &Scene, settings: &RenderSettings) -> Frame {
    let frame = renderer_by(backend).render(scene, settings);
    frame.unwrap_or_else(|error| panic!("{backend}: {error}")).0
}

fn open(mode: RasterMode) -> Mutex<Renderer> {
    let gpu = Gpu::open(Some(&adapter())).unwrap_or_else(|error| panic!("{error}"));
    Mutex::new(Renderer::with_raster(gpu, mode).unwrap_or_else(|error| panic!("{error}")))
}

/// The parameters drawn for a seed with these settings (`key=value`).
pub(crate) fn params(seed: u64, set: &[&str]) -> Params {
    let mut config = Config::new();
    for assignment in set {
        config.apply_set(assignment).unwrap_or_else(|error| panic!("{assignment}: {error}"));
    }
    config.draw(seed).unwrap_or_else(|error| panic!("{error}"))
}

/// The scene of a seed with these settings.
pub(crate) fn scene(seed: u64, set: &[&str]) -> Scene {
    Scene::build(seed, &params(seed, set)).unwrap_or_else(|error| panic!("{error}"))
}

/// A frame of a scene, `side` pixels square.
pub(crate) fn render(scene: &Scene, side: u32, samples: u32) -> Frame {
    let settings = RenderSettings::new([side, side], samples).expect("settings");
    renderer().render(scene, &settings).unwrap_or_else(|error| panic!("{error}")).0
}

/// The command `regolith-render`, run in `folder`, on the adapter of the tests unless a test overrides that.
pub(crate) fn program(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_regolith-render"));
    command.current_dir(folder).env_remove("WGPU_BACKEND").env("WGPU_ADAPTER_NAME", adapter());
    command
}

/// The same, for which no signal is ignored, as whoever runs the tests may have it (`nohup`, a job in the background).
pub(crate) fn stoppable(folder: &Path) -> Command {
    let mut command = Command::new("env");
    command.args(["--default-signal=INT,TERM,HUP", env!("CARGO_BIN_EXE_regolith-render")]);
    command.current_dir(folder).env_remove("WGPU_BACKEND").env("WGPU_ADAPTER_NAME", adapter());
    command
}

/// Runs the command with these arguments.
pub(crate) fn run(folder: &Path, words: &[&str]) -> Output {
    program(folder).args(words).output().expect("the program starts")
}

/// Runs the command, which must succeed; returns its standard output.
pub(crate) fn run_ok(folder: &Path, words: &[&str]) -> String {
    let output = run(folder, words);
    assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The adapter by which tests render below a limit of the file size: newer versions of Mesa's CPU driver for Vulkan keep their memory in an
/// anonymous file, which such a limit concerns too, and their GL driver does not.
pub(crate) fn adapter_below_file_limit() -> [&'static str; 2] {
    static ADAPTER: LazyLock<String> = LazyLock::new(|| {
        let is_software = renderer().gpu().capabilities.software_adapter;
        if is_software { ", gl,".to_owned() } else { adapter() }
    });
    ["--adapter", &ADAPTER]
}

/// Runs the command where no file may be larger than this, KiB, as on a disk that is full. Writing more sends the signal XFSZ, which the
/// shell `traps` (`trap '' XFSZ` has it ignored) or leaves to the command.
pub(crate) fn run_with_file_limit(folder: &Path, (limit_kib, traps): (u32, &str), words: &[&str]) -> Output {
    let limited = format!("ulimit -c 0; ulimit -f {limit_kib}; {traps} exec \"$0\" \"$@\"");
    let whole = program(folder);
    let mut shell = Command::new("bash");
    shell.args(["-c", &limited]).arg(whole.get_program()).args(words).current_dir(folder);
    for (name, value) in whole.get_envs() {
        match value {
            Some(value) => shell.env(name, value),
            None => shell.env_remove(name),
        };
    }
    shell.env("MESA_SHADER_CACHE_DISABLE", "true").output().expect("bash")
}

/// Sends a signal (`-INT`, `-KILL`, ...) to a process, by the shell's own `kill`: a minimal system has no other.
pub(crate) fn send_signal(child: &Child, signal: &str) {
    let sent = Command::new("sh").args(["-c", &format!("kill {signal} {}", child.id())]).status();
    assert!(sent.expect("a shell").success());
}

/// An empty temporary folder.
pub(crate) fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// The values of a float32 .npy file.
pub(crate) fn npy(path: &Path) -> Vec<f32> {
    let bytes = std::fs::read(path).expect("an array");
    let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    bytes[data..].chunks_exact(4).map(|f| f32::from_le_bytes([f[0], f[1], f[2], f[3]])).collect()
}

/// The content of a JSON file.
pub(crate) fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
