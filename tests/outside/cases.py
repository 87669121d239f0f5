"""The scenes to check, with their exports and frames, all made by the release binary."""

import json
import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

BINARY = os.environ["REGOLITH_BINARY"]
WORK = Path(os.environ["REGOLITH_OUTSIDE"])
REGOLITH, ROCK, SKY = 0, 1, 2


@dataclass(frozen=True)
class Case:
    """A seed, its knobs, and the image size in pixels."""

    name: str
    seed: int
    size: tuple[int, int]
    knobs: tuple[str, ...] = ()

    def words(self) -> list[str]:
        """Command line arguments that frames and exports share."""
        knobs = [word for knob in self.knobs for word in ("--set", knob)]
        return ["--seed", str(self.seed), "--size", "{}x{}".format(*self.size), *knobs]


CASES = [
    Case("seed 42", 42, (256, 256)),
    # A low sun in front of a low, wide camera; the image is not square. Few facets of its foreground are grazed by the sun: a
    # known limit, with figures in docs/evidence.md.
    Case(
        "seed 8, extreme",
        8,
        (256, 192),
        ("sun.elevation_deg=5", "sun.azimuth_deg=0", "camera.height_m=1.5", "camera.fov_deg=85"),
    ),
]


def fill_case(seed: int, elevation_deg: float, azimuth_deg: float) -> Case:
    """A surface stage with rocks and their shadows in front of the camera. The sun at azimuth 0 is in front of it.

    Pixels are wide, so that the mesh has all the relief that a frame with one sample a pixel resolves. Dust on rocks is
    off, because exports have one albedo a rock.
    """
    knobs = (
        "stage.name=surface",
        f"sun.elevation_deg={elevation_deg}",
        f"sun.azimuth_deg={azimuth_deg}",
        f"rocks.coverage={0.06 if elevation_deg < 12 else 0.1}",
        "rocks.dust=0",
        "terrain.size_m=120",
        "terrain.cell_mrad=10",
        "camera.y_m=0",
        "camera.height_m=1.6",
        "camera.pitch_deg=-18",
        "camera.fov_deg=80",
    )
    return Case(f"seed {seed}, sun {elevation_deg} deg at {azimuth_deg}", seed, (128, 128), knobs)


# Elevations and azimuths of the suns of `fill_case`, degrees. Azimuths go by the golden angle.
FILL_SUNS = [
    (3, 20),
    (4, 158),
    (5, 295),
    (6, 73),
    (7, 210),
    (8.5, 348),
    (10, 125),
    (11.5, 263),
    (13, 40),
    (15, 178),
    (17, 315),
    (19, 93),
    (21, 230),
    (23, 8),
    (25, 145),
    (28, 283),
    (31, 60),
    (34, 198),
    (37, 335),
    (40, 113),
]
# The first seed for the first sun, and how many seeds each sun has (see path_tracer.py).
FIRST_FILL_SEED, FILL_SEEDS = 4000, 40


@dataclass(frozen=True)
class Frame:
    """The planes of a frame (arrays H x W) and its record."""

    record: dict[str, Any]
    rgb: np.ndarray
    classes: np.ndarray
    instances: np.ndarray
    depth_m: np.ndarray
    normals: np.ndarray
    sun_occlusion: np.ndarray

    @property
    def k(self) -> np.ndarray:
        """Intrinsic matrix, pixels."""
        return np.array(self.record["camera"]["K"])

    @property
    def pose(self) -> np.ndarray:
        """World from camera, OpenCV axes, metres."""
        return np.array(self.record["camera"]["world_from_camera"])

    @property
    def sun(self) -> np.ndarray:
        """Unit vector towards the sun."""
        return np.array(self.record["sun"]["direction"])


@dataclass(frozen=True)
class Soup:
    """The triangles of an .npz export; other formats are compared with it."""

    vertices: np.ndarray
    triangles: np.ndarray
    instances: np.ndarray
    arrays: dict[str, np.ndarray]

    def part(self, instance: int) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (metres, world) and triangles of an instance: a rock, or the ground (0)."""
        triangles = self.triangles[self.instances == instance].astype(np.int64)
        first, last = triangles.min(), triangles.max()
        return self.vertices[first : last + 1], triangles - first


def run(*words: str) -> subprocess.CompletedProcess[str]:
    """Runs the binary and captures its output."""
    return subprocess.run([BINARY, *words], capture_output=True, text=True, check=False)


def formats() -> list[str]:
    """Export formats, by extension, as the binary lists them in its error message."""
    message = run("export", "stage.unknown").stderr
    return re.findall(r"\.([a-z0-9]+)", message.partition("use one of")[2])


def export(case: Case, extension: str, drawn: bool) -> Path:
    """Exports the stage and returns the file's path."""
    path = WORK / f"{case.seed}{'_drawn' if drawn else ''}.{extension}"
    result = run("export", str(path), "--force", *case.words(), *(["--drawn"] if drawn else []))
    if result.returncode:
        raise RuntimeError(result.stderr.strip())
    return path


def render(case: Case, samples: int) -> Frame:
    """Renders the frame with all outputs."""
    folder = WORK / f"frame_{case.seed}_{samples}"
    more = ["--samples", str(samples), "--outputs", "all", "--out", str(folder), "--force", "--quiet"]
    result = run(*case.words(), *more)
    if result.returncode:
        raise RuntimeError(result.stderr.strip())

    def image(stem: str) -> np.ndarray:
        return np.array(Image.open(folder / f"{stem}_0000.png"))

    return Frame(
        record=json.loads((folder / "frame_0000.json").read_text()),
        rgb=image("rgb"),
        classes=image("semantic_segmentation").astype(int),
        instances=image("instance_segmentation").astype(int),
        depth_m=np.load(folder / "distance_to_image_plane_0000.npy").astype(float),
        normals=np.load(folder / "normals_0000.npy").astype(float),
        sun_occlusion=image("shadow") / 255.0,
    )


def soup(path: Path) -> Soup:
    """Reads an .npz export."""
    arrays = dict(np.load(path))
    return Soup(
        vertices=arrays["vertices"].astype(float),
        triangles=arrays["triangles"],
        instances=arrays["triangle_instance"].astype(int),
        arrays=arrays,
    )
