"""Compares exports and frames with usd-core, trimesh, Embree, Blender and Mitsuba. Run through check.sh."""

import importlib.util
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial

import blender
import gltf_stage
import pixels
import usd_stage
from cases import CASES, FILL_SUNS, Case, export, formats, render, soup
from report import Report

USD_FORMATS = ("usda", "usdc")
CHECKED_FORMATS = {"npz", "glb", *USD_FORMATS}


def check_case(report: Report, number: int, case: Case) -> None:
    """Checks one scene: every export format, as authored and as drawn, then the frame's pixels."""
    frame = render(case, samples=1)
    usd = [extension for extension in USD_FORMATS if extension in formats()]
    for drawn in (False, True):
        arrays = soup(export(case, "npz", drawn))
        for extension in usd:
            usd_stage.check(export(case, extension, drawn), frame, arrays, report)
        gltf_stage.check(export(case, "glb", drawn), frame, arrays, report)
    # `arrays` now holds the triangles that the frame draws.
    pixels.check(frame, arrays, report)
    if importlib.util.find_spec("bpy"):
        blender.check(export(case, usd[number % len(usd)], drawn=True), frame, report)


def check_fill(report: Report, number: int, elevation_deg: float, azimuth_deg: float) -> None:
    """Checks the light within the shadows of the scene of one sun."""
    import path_tracer

    path_tracer.check(number, elevation_deg, azimuth_deg, report)


def check_fill_of_all(report: Report) -> None:
    """Checks the light within the shadows of all scenes together."""
    import path_tracer

    path_tracer.check_all(report)


def guarded(report: Report, name: str, check: Callable[[], None]) -> None:
    """Runs a check; an exception becomes a failing row, and the other scenes still run."""
    report.case = name
    try:
        check()
    except Exception as error:  # any exception of any reader
        traceback.print_exc()
        report.none("the check ran", [f"{type(error).__name__}: {error}"], "yes")


def main() -> int:
    """Runs every check; returns the exit status."""
    start = time.monotonic()
    report = Report(case="formats")
    listed = formats()
    report.none("export formats, each with a check", sorted(set(listed) - CHECKED_FORMATS), " ".join(listed))
    for number, case in enumerate(CASES):
        guarded(report, case.name, partial(check_case, report, number, case))
    if importlib.util.find_spec("mitsuba"):
        for number, (elevation_deg, azimuth_deg) in enumerate(FILL_SUNS):
            name = f"sun {elevation_deg} deg at {azimuth_deg}"
            guarded(report, name, partial(check_fill, report, number, elevation_deg, azimuth_deg))
        guarded(report, f"{len(FILL_SUNS)} scenes", partial(check_fill_of_all, report))
    else:
        print("!!! MITSUBA DID NOT RUN: PyPI has no wheel of it for this machine !!!", file=sys.stderr)
    report.print()
    failed = len(report.failed())
    print(f"{len(report.rows) - failed} of {len(report.rows)} hold; {time.monotonic() - start:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
