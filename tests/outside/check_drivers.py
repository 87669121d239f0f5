"""Renders frames and datasets on two independent Vulkan drivers under the validation layers: no message, and the same masks; runs
`doctor` on them and on Mesa's GL driver; compares labels and depth of the compute pass that rasterises between the drivers, which must
have the same bytes; and compares the host's frames with the device's on each driver, by the suite's test in backends.rs.

The drivers are Mesa's lavapipe and Google's SwiftShader. SwiftShader and the layers, which also check synchronization, come
from Debian's package chromium-common; nothing is installed. Run through check.sh.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from report import Report

PACKAGE = "chromium-common"
ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ["REGOLITH_BINARY"]
WORK = Path(os.environ["REGOLITH_OUTSIDE"]) / "drivers"
LAYER = "VK_LAYER_KHRONOS_validation"
# Performance hints are left out: naga writes every output of a vertex stage, whether or not the fragment stage reads it.
SETTINGS = """\
khronos_validation.debug_action = VK_DBG_LAYER_ACTION_LOG_MSG
khronos_validation.report_flags = error,warn,info
khronos_validation.log_filename = {log}
khronos_validation.validate_sync = true
"""
MESSAGE = re.compile(r"^Validation (Error|Warning): \[ (\S+) \]", re.MULTILINE)
# What the layers say first, if they run with all checks; a frame counts only then.
ACTIVE = ("Current Validation Enabled", "- Core Checks", "- Synchronization")
# A known defect of naga, which gives local arrays and structs the layout that only those in buffers may have. Drivers ignore
# it there (SPIRV-Tools, issue 6193).
KNOWN = {"VUID-StandaloneSpirv-None-10684"}
# Largest fraction of the pixels whose class differs between the drivers; each of them lies on an outline.
MAX_DIFFERENT = 0.001
# Options of a scene, and the raster backends to try.
SCENES = {
    "nominal, seed 42": (["--seed", "42"], ("device", "host")),
    "nominal, sun in front": (["--seed", "7", "--set", "sun.elevation_deg=5", "--set", "sun.azimuth_deg=0"], ("device",)),
    "surface, seed 42": (["--stage", "surface", "--seed", "42"], ("device",)),
    "surface, lens": (["--stage", "surface", "--seed", "3", "--set", "camera.k1=-0.1"], ("device", "host")),
}
SIZE = ["--size", "256", "--outputs", "all"]
# What has the same bytes on every driver where a compute pass rasterises.
COMPUTED = ("semantic_segmentation_0000.png", "instance_segmentation_0000.png", "distance_to_camera_0000.npy")
# The test that compares the raster backends, the scenes that it gets on each driver, and the lines that it prints.
BACKENDS = "backends::backends_agree_in_depth_colour_and_class"
BACKEND_SCENES = 100
FIGURES = re.compile(rf"{BACKEND_SCENES} scenes: (.*)")


@dataclass(frozen=True)
class Driver:
    """A Vulkan driver: its name, the text that its adapter's name contains, and the file that describes it."""

    name: str
    adapter: str
    icd: Path


def unpacked() -> Path:
    """The package's folder with SwiftShader and the layers, below the work folder."""
    root = WORK / PACKAGE
    if not root.is_dir():
        partial = WORK / "partial"
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        subprocess.run(["apt-get", "download", "-qq", PACKAGE], cwd=partial, check=True, stderr=subprocess.DEVNULL)
        for archive in partial.glob("*.deb"):
            subprocess.run(["dpkg", "-x", archive.name, "."], cwd=partial, check=True)
            archive.unlink()
        partial.rename(root)
    return only(root.rglob("libvk_swiftshader.so"), f"SwiftShader in {PACKAGE}").parent


def only(paths: Iterable[Path], what: str) -> Path:
    """The first of some paths; there must be one."""
    found = sorted(paths)
    if not found:
        sys.exit(f"tests/outside: {what} was not found")
    return found[0]


def describe_layer(folder: Path) -> None:
    """Writes the file by which the Vulkan loader finds the layer."""
    library = only(folder.glob("libVkLayer_khronos_validation.so"), f"the validation layer in {PACKAGE}")
    layer = {
        "name": LAYER,
        "type": "GLOBAL",
        "library_path": str(library),
        "api_version": "1.4.0",
        "implementation_version": "1",
        "description": "Khronos validation layer",
    }
    (WORK / "layer.json").write_text(json.dumps({"file_format_version": "1.2.0", "layer": layer}))


def environment_of(driver: Driver) -> dict[str, str]:
    """Environment in which this driver is the only one."""
    return {
        **os.environ,
        "VK_DRIVER_FILES": str(driver.icd),
        "VK_ICD_FILENAMES": str(driver.icd),
        "WGPU_BACKEND": "vulkan",
        "WGPU_ADAPTER_NAME": driver.adapter,
    }


def under_layers(driver: Driver, words: list[str]) -> str:
    """Runs the program under the layers. Returns what these wrote."""
    log, settings, cache = (WORK / name for name in ("messages.txt", "vk_layer_settings.txt", "cache"))
    # Without a cache every shader is compiled, so that the layers see it.
    shutil.rmtree(cache, ignore_errors=True)
    log.unlink(missing_ok=True)
    settings.write_text(SETTINGS.format(log=log))
    environment = {
        **environment_of(driver),
        "VK_INSTANCE_LAYERS": LAYER,
        "VK_LAYER_PATH": str(WORK),
        "VK_LAYER_SETTINGS_PATH": str(settings),
        "XDG_CACHE_HOME": str(cache),
    }
    command = [PROGRAM, *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    return log.read_text() if log.exists() else ""


def check_layers(report: Report, name: str, text: str) -> None:
    """Adds what the layers wrote to the report."""
    missing = [what for what in ACTIVE if what not in text]
    report.none(f"{name}: layers run", [f"not {what}" for what in missing], "all checks")
    faults = [found[2] for found in MESSAGE.finditer(text) if found[2] not in KNOWN]
    report.none(f"{name}: messages of the layers", faults, "none")


def on_outline(mask: np.ndarray) -> np.ndarray:
    """Pixels that have a neighbour of another class, of the eight around them."""
    padded = np.pad(mask, 1, mode="edge")
    height, width = mask.shape
    shifted = [padded[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.any([other != mask for other in shifted], axis=0)


def check_frame(report: Report, name: str, driver: Driver, scene: list[str], raster: str) -> np.ndarray:
    """Renders a frame, adds what the layers found to the report, and returns the mask."""
    out = WORK / "frame"
    shutil.rmtree(out, ignore_errors=True)
    text = under_layers(driver, [*scene, *SIZE, "--raster", raster, "--out", str(out), "--quiet"])
    record = json.loads((out / "frame_0000.json").read_text())
    adapter = f"{record['adapter']['name']}, {record['raster']}"
    is_right = driver.adapter in record["adapter"]["name"].lower() and record["raster"] == raster
    report.none(f"{name}: adapter and raster", [] if is_right else [adapter], adapter)
    check_layers(report, name, text)
    return np.array(Image.open(out / "semantic_segmentation_0000.png"))


def check_scene(report: Report, drivers: list[Driver], scene: list[str], rasters: tuple[str, ...]) -> None:
    """Renders a scene on every driver, and compares masks with those of the first."""
    runs = [(f"{driver.name}, {raster}", driver, raster) for raster in rasters for driver in drivers]
    (first, reference), *others = [(name, check_frame(report, name, driver, scene, raster)) for name, driver, raster in runs]
    for name, mask in others:
        different = mask != reference
        outline = on_outline(mask) | on_outline(reference)
        what = f"{name}: pixels of another class than {first}"
        report.at_most(what, 100 * different.mean(), 100 * MAX_DIFFERENT, " %")
        inside = int((different & ~outline).sum())
        report.none(f"{what}, not on an outline", [f"{inside} px"] if inside else [], int(outline.sum()))


def check_computed(report: Report, drivers: list[Driver], scene: list[str]) -> None:
    """Rasterises in a compute pass on every driver: labels and depth have the bytes that they have on the first."""
    first: dict[str, bytes] = {}
    for driver in drivers:
        check_frame(report, f"{driver.name}, compute", driver, scene, "compute")
        planes = {name: (WORK / "frame" / name).read_bytes() for name in COMPUTED}
        first = first or planes
        different = [name for name in COMPUTED if planes[name] != first[name]]
        report.none(f"{driver.name}, compute: other bytes than {drivers[0].name}", different, ", ".join(COMPUTED))


def check_lighting(report: Report, driver: Driver, lighting: str, stage: str) -> None:
    """Lights as GPUs do, which CPU drivers do not by default, under the layers."""
    words = ["bench", "--raster", "device", "--lighting", lighting, "--stage", stage]
    words += ["--cases", "camera", "--frames", "1", "--outputs", "all", "--size", "64", "--json", "--quiet"]
    check_layers(report, f"{driver.name}, {stage}", under_layers(driver, words))


def check_dataset(report: Report, driver: Driver, raster: str, stage: str) -> None:
    """Makes a dataset, whose workers write uploads to buffers that later frames use again, under the layers."""
    out = WORK / "dataset"
    shutil.rmtree(out, ignore_errors=True)
    words = ["dataset", "--raster", raster, "--stage", stage, "--count", "5", "--size", "64", "--out", str(out), "--quiet"]
    check_layers(report, f"{driver.name}, {raster}, {stage}", under_layers(driver, words))


def check_doctor(report: Report, name: str, driver: Driver, backend: str, rasters: set[str]) -> None:
    """Runs `doctor` without layers: every raster backend of the adapter runs and is right."""
    out = WORK / "doctor"
    shutil.rmtree(out, ignore_errors=True)
    environment = {**environment_of(driver), "WGPU_BACKEND": backend}
    command = [PROGRAM, "doctor", "--json", "--quiet", "--out", str(out)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    result = json.loads(done.stdout)
    devices = [run["device"] for run in result["runs"] if run["device"]]
    found = {run["backend"] for run in result["runs"] if run["frames"]}
    adapters = {device["adapter"] for device in devices}
    is_right = all(driver.adapter in adapter.lower() and backend in adapter for adapter in adapters)
    report.none(f"{name}: adapter", [] if is_right else sorted(adapters), " ".join(sorted(adapters)))
    report.none(f"{name}: raster backends", sorted(found ^ rasters), ", ".join(sorted(found)))
    wrong = [
        f"{check['case']} {check['backend']} {check['plane']}: {check['text']}"
        for check in result["checks"]
        if check["verdict"] == "wrong"
    ]
    failed = [failure["message"] for run in result["runs"] for failure in run["failures"]]
    report.none(f"{name}: wrong planes", wrong, f"none of {len(result['checks'])}")
    report.none(f"{name}: failed steps", failed, "none")
    status = [f"{done.returncode}"] if done.returncode else []
    report.none(f"{name}: exit status", status, "0")


def check_backends(report: Report, driver: Driver) -> None:
    """Compares the raster backends on a driver, over many scenes."""
    command = ["cargo", "test", "--release", "--quiet", "--test", "suite", "--", "--exact", "--nocapture", BACKENDS]
    environment = {**environment_of(driver), "REGOLITH_BACKEND_SCENES": str(BACKEND_SCENES)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    figures = FIGURES.findall(done.stdout)
    faults = [line for line in done.stderr.splitlines() if "differs by" in line or "another class" in line]
    if done.returncode and not faults:
        faults = [done.stderr.strip() or done.stdout.strip()]
    is_right = len(figures) == 2 and driver.adapter in done.stdout.lower()
    for backend, found in zip(("device", "compute"), figures if is_right else (0, 0), strict=True):
        report.none(f"{driver.name}: host and {backend}", faults, found)


def main() -> int:
    """Renders every scene; returns the exit status."""
    WORK.mkdir(parents=True, exist_ok=True)
    package = unpacked()
    describe_layer(package)
    lavapipe = only(Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json"), "lavapipe (apt-get install mesa-vulkan-drivers)")
    swiftshader = only(package.glob("vk_swiftshader_icd.json"), f"the description of SwiftShader in {PACKAGE}")
    drivers = [Driver("lavapipe", "llvmpipe", lavapipe), Driver("SwiftShader", "swiftshader", swiftshader)]
    report = Report()
    for name, (scene, rasters) in SCENES.items():
        report.case = name
        check_scene(report, drivers, scene, rasters)
        check_computed(report, drivers, scene)
    for lighting in ("one-draw", "compute"):
        report.case = f"lighting: {lighting}"
        for driver in drivers:
            for stage in ("nominal", "surface"):
                check_lighting(report, driver, lighting, stage)
    report.case = "datasets"
    for driver in drivers:
        for raster, stage in (("compute", "surface"), ("device", "nominal")):
            check_dataset(report, driver, raster, stage)
    report.case = "doctor"
    on_device = {"device-bins", "device-one-draw"}
    vulkan = {"host", "compute-one-draw", "compute-compute", *on_device}
    for driver in drivers:
        check_doctor(report, driver.name, driver, "vulkan", vulkan)
    check_doctor(report, f"{drivers[0].name}, GL", drivers[0], "gl", {"mixed", *on_device})
    report.case = f"{BACKEND_SCENES} scenes"
    for driver in drivers:
        check_backends(report, driver)
    report.print()
    failed = len(report.failed())
    print(f"{len(report.rows) - failed} of {len(report.rows)} hold")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
