"""Makes docs/presets/NAME.jpg: the first five frames that a dataset of each preset has; and assets/surface_four.png, for `four` among the
names or without any.

    python tests/outside/preset_sheets.py target/release/regolith-render [NAME ...]

Needs Pillow. Presets of suns and cameras are joined with a training preset of the surface stage.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[2]
SHEETS = ROOT / "docs/presets"
FRAMES = 5
SIZE = (256, 192)
# Of each frame of assets/surface_four.png: the seed, and knobs.
FOUR = (
    (901, {"sun.elevation_deg": 5, "sun.relative_azimuth_deg": 110, "camera.pitch_deg": -8, "camera.fov_deg": 50}),
    (145, {"sun.elevation_deg": 15, "sun.relative_azimuth_deg": 75, "camera.pitch_deg": -9, "camera.fov_deg": 45}),
    (67, {"sun.elevation_deg": 15, "sun.relative_azimuth_deg": 285, "camera.pitch_deg": -22, "camera.fov_deg": 35}),
    (395, {"sun.elevation_deg": 30, "sun.relative_azimuth_deg": 120, "camera.pitch_deg": -28, "camera.fov_deg": 40}),
)
FOUR_SIZE = (400, 300)


def preset_names(program: str) -> list[str]:
    listing = subprocess.run([program, "presets", "--json"], check=True, capture_output=True, text=True).stdout
    return [row["name"] for row in json.loads(listing)]


def sheet(program: str, name: str) -> Image.Image:
    """Frames of a preset, beside each other."""
    with_sensor = {"sun_": "surface_train_full,", "camera": "surface_train_dr,"}
    joined = next((base for start, base in with_sensor.items() if name.startswith(start)), "") + name
    result = Image.new("RGB", (FRAMES * SIZE[0] + 4 * (FRAMES - 1), SIZE[1]), "white")
    with tempfile.TemporaryDirectory() as folder:
        size = f"{2 * SIZE[0]}x{2 * SIZE[1]}"
        command = [program, "dataset", "--preset", joined, "--count", str(FRAMES), "--size", size, "--out", folder, "-q"]
        subprocess.run(command, check=True)
        for i in range(FRAMES):
            with Image.open(Path(folder) / f"rgb/rgb_{i:05}.png") as image:
                result.paste(image.resize(SIZE, Image.Resampling.BOX), (i * (SIZE[0] + 4), 0))
    return result


def four_frames(program: str) -> Image.Image:
    """Frames of the surface stage, through a monochrome sensor, beside each other."""
    (width, height), gap = FOUR_SIZE, 8
    result = Image.new("RGB", (4 * width + 3 * gap, height), "white")
    for i, (seed, knobs) in enumerate(FOUR):
        every = {**knobs, "sensor.kind": "mono", "rocks.coverage": 0.03, "rover.visible": "no"}
        command = [program, "--stage", "surface", "--seed", str(seed), "--size", f"{width}x{height}", "--samples", "16", "-q"]
        for name, value in every.items():
            command += ["--set", f"{name}={value}"]
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([*command, "--out", folder], check=True)
            with Image.open(Path(folder) / "rgb_0000.png") as image:
                result.paste(image, (i * (width + gap), 0))
    return result


def main() -> None:
    program, *names = sys.argv[1:]
    SHEETS.mkdir(exist_ok=True)
    for name in names or ["four", *preset_names(program)]:
        if name == "four":
            four_frames(program).save(ROOT / "assets/surface_four.png", optimize=True)
        else:
            sheet(program, name).save(SHEETS / f"{name}.jpg", quality=82, optimize=True)
        print(name, flush=True)


if __name__ == "__main__":
    main()
