"""Makes assets/evidence.png: a frame, the same stage path-traced by Cycles, and their difference.

    tests/outside/check.sh evidence.py [SAMPLES]

Both have the same triangles, camera, sun, albedo, diffuse lobe and tone curve. The renderer estimates one bounce from
sunlit ground; Cycles traces eight bounces.
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
IMAGE = Path(__file__).resolve().parents[2] / "assets" / "evidence.png"
SAMPLES = 512
# Factor by which the difference is brightened.
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
    """Panels side by side, each with its name."""
    height, width = panels[0][1].shape[:2]
    image = Image.new("RGB", (len(panels) * (width + GAP_PX) - GAP_PX, height), "white")
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size=13)
    for index, (name, pixels) in enumerate(panels):
        left = index * (width + GAP_PX)
        image.paste(Image.fromarray(pixels), (left, 0))
        draw.text((left + 8, 6), name, fill="white", font=font)
    return image


def main() -> None:
    """Renders, compares, writes the image and prints statistics."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else SAMPLES
    frame = render(CASE, samples=16)
    knobs = frame.record["knobs"]
    irradiance = [IRRADIANCE_PER_INTENSITY * knobs["sun.intensity"] * channel for channel in knobs["sun.color"]]
    words = [str(number) for number in (samples, *irradiance)]
    traced = displayed(cycles(export(CASE, "usda", drawn=True), frame, "beauty", *words)["radiance"])
    difference = np.abs(frame.rgb.astype(int) - traced).max(-1)
    shown = np.repeat(np.clip(FACTOR * difference, 0, 255).astype(np.uint8)[..., None], 3, -1)
    names = ("regolith-render", f"Cycles, {samples} paths a pixel", f"difference x {FACTOR}")
    row(list(zip(names, (frame.rgb, traced, shown), strict=True))).save(IMAGE, optimize=True)

    lit = (frame.classes != SKY) & (frame.sun_occlusion < 0.01)
    dark = (frame.classes != SKY) & (frame.sun_occlusion > 0.99)
    print(f"{IMAGE}: {IMAGE.stat().st_size} bytes")
    for name, where in (("all", difference >= 0), ("sunlit", lit), ("in shadow", dark)):
        values = difference[where]
        print(
            f"{name}: {where.sum()} px, difference of 255: median {np.median(values):.1f}, mean {values.mean():.2f}, "
            f"99 % {np.quantile(values, 0.99):.0f}"
        )
        for side, image in (("ours", frame.rgb), ("Cycles", traced)):
            print(f"    {side} mean {image[where].mean(0).round(1)}")


if __name__ == "__main__":
    main()
