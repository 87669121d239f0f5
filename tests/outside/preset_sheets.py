"""Makes docs/presets/NAME.jpg: the first five frames that a dataset of each preset has.

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


def main() -> None:
    program, *names = sys.argv[1:]
    SHEETS.mkdir(exist_ok=True)
    for name in names or preset_names(program):
        sheet(program, name).save(SHEETS / f"{name}.jpg", quality=82, optimize=True)
        print(name, flush=True)


if __name__ == "__main__":
    main()
