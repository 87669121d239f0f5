"""A frame beside the same stage path-traced by Cycles, and their difference: makes assets/evidence.png anew.

    tests/outside/check.sh evidence.py [SAMPLES]

Both have the same triangles, camera, sun, albedo and diffuse lobe, and the same tone curve. Ours estimates the light
that the ground bounces; Cycles follows it over eight bounces.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from blender import cycles
from cases import SKY, Case, export, render

CASE = Case(
    "evidence",
    5,
    (320, 240),
    (
        "sun.azimuth_deg=75",
        "sun.elevation_deg=14",
        "camera.height_m=4",
        "camera.pitch_deg=-9",
        "camera.fov_deg=52",
    ),
)
PICTURE = Path(__file__).resolve().parents[2] / "assets" / "evidence.png"
SAMPLES = 512
# How much brighter the difference is shown than it is.
FACTOR = 4
GAP_PX = 4
# Irradiance per unit of the intensity knob, and the tone curve: see src/scene/sky.rs and shaders/common/tone.wgsl.
IRRADIANCE_PER_INTENSITY = 1.66e-3
KNEE, WHITE = 0.85, 0.947307


def displayed(radiance: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear radiance at 0 EV."""
    largest = np.maximum(radiance.max(-1, keepdims=True), 1e-9)
    room = WHITE - KNEE
    shoulder = KNEE + room * (1 - np.exp(-(largest - KNEE) / room))
    toned = np.where(largest <= KNEE, radiance, radiance * shoulder / largest)
    encoded = np.where(toned <= 0.0031308, 12.92 * toned, 1.055 * np.maximum(toned, 0.0) ** (1 / 2.4) - 0.055)
    return np.clip(255 * encoded + 0.5, 0, 255).astype(np.uint8)


def row(panels: list[tuple[str, np.ndarray]]) -> Image.Image:
    """The panels side by side, each with its name."""
    height, width = panels[0][1].shape[:2]
    picture = Image.new("RGB", (len(panels) * (width + GAP_PX) - GAP_PX, height), "white")
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(size=13)
    for index, (name, pixels) in enumerate(panels):
        left = index * (width + GAP_PX)
        picture.paste(Image.fromarray(pixels), (left, 0))
        draw.text((left + 8, 6), name, fill="white", font=font)
    return picture


def main() -> None:
    """Renders, compares, writes."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else SAMPLES
    frame = render(CASE, samples=16)
    knobs = frame.record["knobs"]
    irradiance = [IRRADIANCE_PER_INTENSITY * knobs["sun.intensity"] * channel for channel in knobs["sun.color"]]
    words = [str(number) for number in (samples, *irradiance)]
    traced = displayed(cycles(export(CASE, "usda", drawn=True), frame, "beauty", *words)["radiance"])
    difference = np.abs(frame.rgb.astype(int) - traced).max(-1)
    shown = np.repeat(np.clip(FACTOR * difference, 0, 255).astype(np.uint8)[..., None], 3, -1)
    names = ("regolith-render", f"Cycles, {samples} paths a pixel", f"difference x {FACTOR}")
    row(list(zip(names, (frame.rgb, traced, shown), strict=True))).save(PICTURE, optimize=True)

    lit = (frame.classes != SKY) & (frame.hidden < 0.01)
    dark = (frame.classes != SKY) & (frame.hidden > 0.99)
    print(f"{PICTURE}: {PICTURE.stat().st_size} bytes")
    for name, where in (("all", difference >= 0), ("sunlit", lit), ("in shadow", dark)):
        values = difference[where]
        print(
            f"{name}: {where.sum()} px, difference of 255: median {np.median(values):.1f}, mean {values.mean():.2f}, "
            f"99 % {np.quantile(values, 0.99):.0f}"
        )
        for side, picture in (("ours", frame.rgb), ("Cycles", traced)):
            print(f"    {side} mean {picture[where].mean(0).round(1)}")


if __name__ == "__main__":
    main()
