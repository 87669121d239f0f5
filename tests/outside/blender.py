"""Blender imports the OpenUSD stage; Cycles must find the same rocks, depths, normals and shadows."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from cases import REGOLITH, ROCK, SKY, WORK, Frame
from pixels import iou
from report import Report

WORKER = Path(__file__).with_name("blender_worker.py")
WORKER_SKY = 30000
# Cosine of incidence below which facets as small as a pixel decide whether a surface is lit.
GRAZING = 0.02
# With fewer pixels than this a quantity is not judged.
ENOUGH_PIXELS = 1000
# Surface, class id, smallest agreement on lit or not (per cent), largest mean error of the sun occlusion.
BOUNDS = (("ground", REGOLITH, 99.9, 0.001), ("rocks", ROCK, 97.0, 0.04))
LIBRARIES = "libgl1 libsm6 libxfixes3 libxi6 libxkbcommon0 libxrender1"


def cycles(stage: Path, frame: Frame, *words: str) -> dict[str, np.ndarray]:
    """Runs the worker on a stage, in a process of its own because Blender bundles its own OpenUSD."""
    height, width = frame.classes.shape
    out = WORK / "cycles.npz"
    angle_deg = frame.record["sun"]["angular_diameter_deg"]
    numbers = [str(number) for number in (width, height, angle_deg)]
    command = [sys.executable, str(WORKER), str(stage), str(out), *numbers, *words]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        hint = f" (Debian, Ubuntu: apt-get install {LIBRARIES})" if "shared object file" in result.stderr else ""
        raise RuntimeError(f"Blender: {result.stderr.strip()[-600:]}{hint}")
    return dict(np.load(out))


def check(stage: Path, frame: Frame, report: Report) -> None:
    """Compares labels, depth, normals and shadows of every pixel."""
    name = f"Cycles ({stage.name})"
    traced = cycles(stage, frame, "planes")
    ids = traced["instance"]
    classes = np.where(ids >= WORKER_SKY, SKY, np.where(ids > 0, ROCK, REGOLITH))
    report.at_least(f"{name}: IoU of rock", iou(frame.classes, classes, ROCK), 0.999)
    report.at_least(f"{name}: IoU of regolith", iou(frame.classes, classes, REGOLITH), 0.999)
    rocks = frame.classes == ROCK
    report.at_least(f"{name}: rock pixels with the same rock", 100 * (ids == frame.instances)[rocks].mean(), 99.9, " %")

    same = (frame.classes != SKY) & (classes == frame.classes) & ((ids == frame.instances) | ~rocks)
    depth_m = (traced["position"] - frame.pose[:3, 3]) @ frame.pose[:3, 2]
    error = np.abs(frame.depth_m[same] / depth_m[same] - 1)
    report.at_most(f"{name}: depth error, 99 %", np.quantile(error, 0.99), 2e-4)
    cosine = np.clip((frame.normals * traced["normal"]).sum(-1)[same], -1, 1)
    report.at_most(f"{name}: normal error, 99 %", np.degrees(np.arccos(np.quantile(cosine, 0.01))), 0.5, " deg")
    _check_shadows(name, frame, traced, same, report)


def _check_shadows(name: str, frame: Frame, traced: dict[str, np.ndarray], same: np.ndarray, report: Report) -> None:
    """Compares sun occlusion where both the smooth surface and its facet face the sun.

    Cycles gives the irradiance under a sun of irradiance 1: the occluded fraction is what it lacks to the cosine.
    """
    facing = traced["normal"] @ frame.sun
    lit_side = same & (facing > GRAZING) & (traced["facet_normal"] @ frame.sun > GRAZING)
    occlusion = 1 - np.clip(traced["sunlight"] / np.maximum(facing, GRAZING), 0, 1)
    for surface, label, min_agreement, max_error in BOUNDS:
        where = lit_side & (frame.classes == label)
        ours, theirs = frame.sun_occlusion[where], occlusion[where]
        if where.sum() < ENOUGH_PIXELS:
            continue
        what = f"{name}: shadow on {surface}, {where.sum()} px"
        report.at_least(f"{what}: lit or not as in ours", 100 * ((ours > 0.5) == (theirs > 0.5)).mean(), min_agreement, " %")
        report.at_most(f"{what}: sun occlusion error, mean", np.abs(ours - theirs).mean(), max_error)
        if surface == "ground":
            report.at_least(f"{what}: IoU of {(theirs > 0.5).sum()} dark px", iou(ours > 0.5, theirs > 0.5, True), 0.97)
