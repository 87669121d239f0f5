"""Skies and clipped pixels of every preset: a dataset of small frames of each without glare, read back from its PNGs.

    tests/outside/check.sh check_exposure.py [--frames N] [NAME ...]

Presets of suns and cameras are joined with a training preset of the surface stage. The dome of the nominal stage has a radiance of
its own, and so its sky is as bright as that: there only the clipped pixels count.
"""

import argparse
import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from report import Report

PROGRAM = os.environ["REGOLITH_BINARY"]
SIDE = 96
SKY = 2
# Largest median of the sky's brightest channel, of 255: the sun and its bloom may be a part of a sky.
MAX_SKY = 3.0
# The tone curve ends at 249: see src/dataset/rules.rs.
WHITE = 249
# Largest clipped part of an image, and of the frames that exceed it.
MAX_CLIPPED, MAX_OVEREXPOSED = 0.2, 1 / 200
# Pixels beside anything else show its point spread.
BORDER = 2


def joined(name: str) -> str:
    """What a preset of a sun or a camera is a part of."""
    bases = {"sun_": "surface_train_full,", "camera_": "surface_train_dr,"}
    return next((base for start, base in bases.items() if name.startswith(start)), "") + name


def eroded(mask: np.ndarray) -> np.ndarray:
    """Pixels of a mask all of whose neighbours within `BORDER` are in it."""
    padded = np.pad(mask, BORDER, mode="edge")
    height, width = mask.shape
    reach = range(2 * BORDER + 1)
    return np.logical_and.reduce([padded[y : y + height, x : x + width] for y in reach for x in reach])


def measure(folder: Path, count: int) -> tuple[list[float], list[float]]:
    """Of each frame the median of its sky's brightest channel and the clipped part of the image."""
    skies, clipped = [], []
    for index in range(count):
        with Image.open(folder / f"rgb/rgb_{index:05}.png") as image:
            brightest = np.asarray(image.convert("RGB")).max(axis=2)
        with Image.open(folder / f"mask/mask_{index:05}.png") as image:
            sky = eroded(np.asarray(image) == SKY)
        skies.append(float(np.median(brightest[sky])) if sky.any() else 0.0)
        clipped.append(float((brightest >= WHITE).mean()))
    return skies, clipped


def check(report: Report, name: str, frames: int) -> None:
    report.case = name
    presets = joined(name)
    with tempfile.TemporaryDirectory() as folder:
        command = [PROGRAM, "dataset", "--preset", presets, "--count", str(frames), "--size", str(SIDE)]
        command += ["--set", "sensor.glare=0", "--set", "sensor.flare=0", "--outputs", "rgb,mask", "--out", folder, "-q"]
        subprocess.run(command, check=True)
        manifest = json.loads((Path(folder) / "manifest.json").read_text())
        skies, clipped = measure(Path(folder), frames)
    if manifest["config"]["stage.name"] == "surface":
        report.at_most(f"brightest sky of {frames} frames, median", max(skies), MAX_SKY, " DN")
    overexposed = sum(part > MAX_CLIPPED for part in clipped)
    report.at_most(f"frames clipped over {MAX_CLIPPED:.0%}", overexposed, int(frames * MAX_OVEREXPOSED), "")
    report.at_most("most clipped frame", max(clipped), 1.0, " of the image")
    redraws = sum(manifest["totals"]["redraws"].values())
    report.at_most("redrawn attempts", redraws / frames, 0.25, " a frame")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="presets; all of them if none is named")
    parser.add_argument("--frames", type=int, default=200)
    options = parser.parse_args()
    listing = subprocess.run([PROGRAM, "presets", "--json"], check=True, capture_output=True, text=True).stdout
    report = Report()
    for name in options.names or [row["name"] for row in json.loads(listing)]:
        check(report, name, options.frames)
    report.print()
    return 1 if report.failed() else 0


if __name__ == "__main__":
    raise SystemExit(main())
