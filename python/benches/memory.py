"""Memory, open files and threads of one process over thousands of frames, of every output.

    python memory.py --frames 5000
    python memory.py --frames 5000 --mixed

The frames come from one stream; with `--mixed` from many, and others one by one, in batches, and from scenes, of two renderers. It prints a
line at 100 frames, at 1,000, and at the end.
"""

from __future__ import annotations

import argparse
import gc
import os
from collections.abc import Iterator

import regolith_render as rr

parser = argparse.ArgumentParser(description="Measures what frames leave behind.")
parser.add_argument("--frames", type=int, default=5000)
parser.add_argument("--size", type=int, default=96, help="pixels a side")
parser.add_argument("--preset", default="train_dr")
parser.add_argument("--mixed", action="store_true", help="frames of every kind of call")
parser.add_argument("--adapter", help="a part of the name of a GPU, or cpu")


def usage() -> str:
    gc.collect()
    with open("/proc/self/status") as status:
        fields = dict(line.split(":", 1) for line in status)
    resident = int(fields["VmRSS"].split()[0]) / 1024
    return f"{resident:.0f} MiB resident, {len(os.listdir('/proc/self/fd'))} open files, {int(fields['Threads'])} threads"


def stream(options: argparse.Namespace) -> Iterator[int]:
    """Frames of one stream."""
    renderer = rr.Renderer(options.preset, outputs=rr.outputs(), size=options.size, adapter=options.adapter)
    for frame in renderer.frames(range(2 * options.frames)):
        yield len(frame) > 0


def mixed(options: argparse.Namespace) -> Iterator[int]:
    """A hundred frames at a time, of every kind of call."""
    every, plain = (
        rr.Renderer(options.preset, outputs=outputs, size=options.size, adapter=options.adapter)
        for outputs in (rr.outputs(), "rgb,mask")
    )
    for seed in range(0, 2 * options.frames, 100):
        for frame in every.frames(range(seed, seed + 60)):
            assert len(frame) > 0
        for other in range(seed + 60, seed + 75):
            assert len(plain.render(other)) > 0
        assert len(plain.batch(range(seed + 75, seed + 95))["mask"]) == 20
        scene = every.scene(seed + 95)
        for yaw_deg in range(5):
            assert len(scene.render(rr.Camera(yaw_deg=10.0 * yaw_deg))) > 0
        yield 100


def main() -> None:
    options = parser.parse_args()
    made = 0
    for more in (mixed if options.mixed else stream)(options):
        made += more
        if made in (100, 1000, options.frames):
            print(f"{made} frames: {usage()}", flush=True)
        if made >= options.frames:
            break


if __name__ == "__main__":
    main()
