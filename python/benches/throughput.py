"""How fast frames reach Python, beside the case `frames` of `regolith-render bench`: the same frames, on the same threads, in memory.

    python throughput.py --preset surface_train_full --size 256 --frames 40 --rounds 5

Each round runs both, and the call of every frame by its seed, in processes of their own, in an order that changes from round to round.
It prints the medians and the ratios of frames per second and of processor time, which is of use where others share the cores.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time

import regolith_render as rr

WARM_UP = 3
"""Frames before the measurement, as in `bench`."""

parser = argparse.ArgumentParser(description="Compares the throughput in Python with that of `regolith-render bench`.")
parser.add_argument("--preset", default="train_dr")
parser.add_argument("--size", type=int, default=256, help="pixels a side")
parser.add_argument("--outputs", default="rgb,mask")
parser.add_argument("--frames", type=int, default=60)
parser.add_argument("--rounds", type=int, default=5)
parser.add_argument("--seed", type=int, default=42, help="the base seed of the frames")
parser.add_argument("--prefetch", type=int, default=2)
parser.add_argument("--adapter", help="a part of the name of a GPU, or cpu")
parser.add_argument("--least", type=float, default=0.0, help="exit with 1 if a ratio of frames per second is below this")
parser.add_argument("--measure", choices=("dataset_frames", "frames"), help="measure this and print JSON")

Result = tuple[float, float]
"""Frames per second, and milliseconds of processor time for each."""


def measured(options: argparse.Namespace) -> Result:
    """The frames of a stream."""
    renderer = rr.Renderer(options.preset, size=options.size, outputs=options.outputs, adapter=options.adapter)
    total = WARM_UP + options.frames
    if options.measure == "dataset_frames":
        frames = renderer.dataset_frames(options.seed, end=total, prefetch=options.prefetch)
    else:
        # The seeds of the same frames, where none is redrawn.
        first = next(renderer.dataset_frames(options.seed, end=1)).meta["seed"]
        frames = renderer.frames(range(first, first + total), prefetch=options.prefetch)
    begun, used = 0.0, 0.0
    for number, frame in enumerate(frames, 1):
        assert frame["rgb"].shape[0] == options.size
        if number == WARM_UP:
            begun, used = time.perf_counter(), time.process_time()
    return options.frames / (time.perf_counter() - begun), 1e3 * (time.process_time() - used) / options.frames


def in_process(options: argparse.Namespace, what: str) -> Result:
    device = ["--adapter", options.adapter] if options.adapter else []
    settings = [f"--preset={options.preset}", f"--size={options.size}", f"--outputs={options.outputs}"]
    settings += [f"--seed={options.seed}", f"--frames={options.frames}", *device]
    if what == "bench":
        command = [sys.executable, "-m", "regolith_render", "bench", "--cases=frames", "--json", *settings]
    else:
        command = [sys.executable, __file__, f"--measure={what}", f"--prefetch={options.prefetch}", *settings]
    printed = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    result = json.loads(printed)
    if what == "bench":
        case = result["cases"]["frames"]
        return case["frames_per_second"], case["process_ms"]
    return result[0], result[1]


def main() -> int:
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measured(options)))
        return 0
    kinds = ["bench", "dataset_frames", "frames"]
    results: dict[str, list[Result]] = {kind: [] for kind in kinds}
    for number in range(options.rounds):
        for kind in kinds[number % 3 :] + kinds[: number % 3]:
            results[kind].append(in_process(options, kind))
    print(f"{options.preset}, {options.size} x {options.size}, {options.outputs}, {options.frames} frames, {options.rounds} rounds")
    least = 1.0
    for kind, rows in results.items():
        rates = [a[0] / b[0] for a, b in zip(rows, results["bench"])]
        costs = [a[1] / b[1] for a, b in zip(rows, results["bench"])]
        least = min(least, statistics.median(rates))
        print(
            f"{kind:15} {statistics.median(row[0] for row in rows):8.2f} frames/s ({statistics.median(rates):.3f} of bench, "
            f"{min(rates):.3f} to {max(rates):.3f}), {statistics.median(row[1] for row in rows):8.2f} ms of processor time "
            f"({statistics.median(costs):.3f})"
        )
    return int(least < options.least)


if __name__ == "__main__":
    sys.exit(main())
