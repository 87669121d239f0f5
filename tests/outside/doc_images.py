"""Makes the images of the documentation again, all or those named: docs/presets/NAME.jpg, the first frames that a dataset of each preset
has, and assets/NAME.png. assets/evidence.png is made by evidence.py.

    tests/outside/check.sh doc_images.py [NAME ...]

Presets of suns and cameras are joined with a training preset of the surface stage.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[2]
SHEETS = ROOT / "docs/presets"
ASSETS = ROOT / "assets"
FRAMES = 5
SIZE = (256, 192)
SIXTEEN_SIZE = (320, 240)
GAP_PX = 4
# Of each frame of assets/surface_four.png: the seed, and knobs.
FOUR = (
    (1104, {"sun.elevation_deg": 5, "sun.relative_azimuth_deg": 110, "camera.pitch_deg": -8, "camera.fov_deg": 50}),
    (1121, {"sun.elevation_deg": 15, "sun.relative_azimuth_deg": 75, "camera.pitch_deg": -9, "camera.fov_deg": 45}),
    (1145, {"sun.elevation_deg": 15, "sun.relative_azimuth_deg": 285, "camera.pitch_deg": -22, "camera.fov_deg": 35}),
    (1168, {"sun.elevation_deg": 30, "sun.relative_azimuth_deg": 120, "camera.pitch_deg": -28, "camera.fov_deg": 40}),
)
FOUR_SIZE = (400, 300)


def preset_names(program: str) -> list[str]:
    listing = subprocess.run([program, "presets", "--json"], check=True, capture_output=True, text=True).stdout
    return [row["name"] for row in json.loads(listing)]


def in_rows(images: Iterable[Image.Image], columns: int, gap_px: int = GAP_PX) -> Image.Image:
    """Images of equal size beside each other and below, with white between them."""
    tiles = list(images)
    width, height = (side + gap_px for side in tiles[0].size)
    rows = -(-len(tiles) // columns)
    result = Image.new("RGB", (columns * width - gap_px, rows * height - gap_px), "white")
    for i, tile in enumerate(tiles):
        result.paste(tile, (i % columns * width, i // columns * height))
    return result


def first_frames(program: str, preset: str, count: int, size: tuple[int, int]) -> list[Image.Image]:
    """The first frames of a dataset, rendered twice as large as these."""
    with tempfile.TemporaryDirectory() as folder:
        doubled = f"{2 * size[0]}x{2 * size[1]}"
        command = [program, "dataset", "--preset", preset, "--count", str(count), "--size", doubled, "--out", folder, "-q"]
        subprocess.run(command, check=True)
        images = [Image.open(Path(folder) / f"rgb/rgb_{i:05}.png") for i in range(count)]
        return [image.resize(size, Image.Resampling.BOX) for image in images]


def sheet(program: str, name: str) -> Image.Image:
    """Frames of a preset."""
    with_sensor = {"sun_": "surface_train_full,", "camera": "surface_train_dr,"}
    joined = next((base for start, base in with_sensor.items() if name.startswith(start)), "") + name
    return in_rows(first_frames(program, joined, FRAMES, SIZE), FRAMES)


def frame(program: str, arguments: list[str]) -> Image.Image:
    """A single frame."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([program, *arguments, "-q", "--out", folder], check=True)
        return Image.open(Path(folder) / "rgb_0000.png").convert("RGB")


def four_frames(program: str) -> Image.Image:
    """Frames of the surface stage, through a monochrome sensor."""
    images = []
    for seed, knobs in FOUR:
        every = {**knobs, "sensor.kind": "mono", "rocks.coverage": 0.03, "rover.visible": "no"}
        width, height = FOUR_SIZE
        command = ["--stage", "surface", "--seed", str(seed), "--size", f"{width}x{height}", "--samples", "16"]
        for name, value in every.items():
            command += ["--set", f"{name}={value}"]
        images.append(frame(program, command))
    return in_rows(images, len(images), 8)


def both_stages(program: str) -> Image.Image:
    """Seed 42 on the nominal and on the surface stage."""
    return in_rows((frame(program, ["--stage", stage, "--seed", "42"]) for stage in ("nominal", "surface")), 2)


def sixteen_frames(program: str) -> Image.Image:
    """The first frames of surface_train_full."""
    return in_rows(first_frames(program, "surface_train_full", 16, SIXTEEN_SIZE), 4)


def copy_first_frame(program: str) -> None:
    """The files of the README's first command, as they are: assets/surface_36.png and its mask in colours."""
    command = re.search(r"cargo run --release -- (.*) --out out$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert command, "the README has no first command"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([program, *shlex.split(command[1]), "-q", "--out", folder], check=True)
        for file, name in (("rgb_0000.png", "surface_36.png"), ("preview_0000.png", "surface_36_mask.png")):
            shutil.copyfile(Path(folder) / file, ASSETS / name)


COMPOSED = {"surface_four": four_frames, "surface_sixteen": sixteen_frames, "nominal_and_surface_42": both_stages}


def main() -> None:
    program, names = os.environ["REGOLITH_BINARY"], sys.argv[1:]
    SHEETS.mkdir(exist_ok=True)
    for name in names or ["surface_36", *COMPOSED, *preset_names(program)]:
        if name == "surface_36":
            copy_first_frame(program)
        elif compose := COMPOSED.get(name):
            compose(program).save(ASSETS / f"{name}.png", optimize=True)
        else:
            sheet(program, name).save(SHEETS / f"{name}.jpg", quality=82, optimize=True)
        print(name, flush=True)


if __name__ == "__main__":
    main()
