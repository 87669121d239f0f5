"""Blender imports the OpenUSD stage, and Cycles sees the same rocks, depths, normals and shadows."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from cases import REGOLITH, ROCK, SKY, WORK, Frame
from pixels import iou
from report import Report

WORKER = Path(__file__).with_name("blender_worker.py")
WORKER_SKY = 30000
# Cosine of the sun on a surface that it grazes, where facets of a pixel's size decide.
GRAZING = 0.02
# Fewer pixels of a kind than this say nothing about it.
ENOUGH_PIXELS = 1000
LIBRARIES = "libgl1 libsm6 libxfixes3 libxi6 libxkbcommon0 libxrender1"


def cycles(stage: Path, frame: Frame, *words: str) -> dict[str, np.ndarray]:
    """Runs the worker on a stage; Blender gets a process of its own, for it has an OpenUSD of its own."""
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
    """Labels, depth, normals and shadows of every pixel."""
    name = f"Cycles ({stage.name})"
    seen = cycles(stage, frame, "planes")
    ids = seen["instance"]
    classes = np.where(ids >= WORKER_SKY, SKY, np.where(ids > 0, ROCK, REGOLITH))
    report.at_least(f"{name}: IoU of rock", iou(frame.classes, classes, ROCK), 0.999)
    report.at_least(f"{name}: IoU of regolith", iou(frame.classes, classes, REGOLITH), 0.999)
    rocks = frame.classes == ROCK
    report.at_least(f"{name}: rock pixels with the same rock", 100 * (ids == frame.instances)[rocks].mean(), 99.9, " %")

    same = (frame.classes != SKY) & (classes == frame.classes) & ((ids == frame.instances) | ~rocks)
    depth_m = (seen["place"] - frame.pose[:3, 3]) @ frame.pose[:3, 2]
    off = np.abs(frame.depth_m[same] / depth_m[same] - 1)
    report.at_most(f"{name}: depth off, 99 %", np.quantile(off, 0.99), 2e-4)
    cosine = np.clip((frame.normals * seen["normal"]).sum(-1)[same], -1, 1)
    report.at_most(f"{name}: normals off, 99 %", np.degrees(np.arccos(np.quantile(cosine, 0.01))), 0.5, " deg")
    _check_shadows(name, frame, seen, same, report)


def _check_shadows(name: str, frame: Frame, seen: dict[str, np.ndarray], same: np.ndarray, report: Report) -> None:
    """Hidden fraction of the sun's disc where both the smooth surface and its facet face the sun.

    What Cycles gives is the irradiance of a sun of 1: what it lacks to the cosine is hidden.
    """
    facing = seen["normal"] @ frame.sun
    lit_side = same & (facing > GRAZING) & (seen["facet_normal"] @ frame.sun > GRAZING)
    hidden = 1 - np.clip(seen["sunlight"] / np.maximum(facing, GRAZING), 0, 1)
    for surface, label, least, most in (("ground", REGOLITH, 99.9, 0.001), ("rocks", ROCK, 97.0, 0.04)):
        where = lit_side & (frame.classes == label)
        ours, theirs = frame.hidden[where], hidden[where]
        if where.sum() < ENOUGH_PIXELS:
            continue
        what = f"{name}: shadow on {surface}, {where.sum()} px"
        report.at_least(f"{what}: dark where ours is", 100 * ((ours > 0.5) == (theirs > 0.5)).mean(), least, " %")
        report.at_most(f"{what}: hidden share of the sun off", np.abs(ours - theirs).mean(), most)
        if surface == "ground":
            report.at_least(f"{what}: IoU of {(theirs > 0.5).sum()} dark px", iou(ours > 0.5, theirs > 0.5, True), 0.97)
