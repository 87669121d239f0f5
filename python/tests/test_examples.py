"""The example programs, shortened."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ADAPTER

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name: str, *words: str, folder: Path) -> str:
    command = [sys.executable, str(EXAMPLES / name), "--adapter", ADAPTER, *words]
    example = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    assert example.returncode == 0, example.stdout + example.stderr
    return example.stdout


def test_training_learns(tmp_path: Path) -> None:
    """Mean IoU was 0.76 after these steps; a network that calls everything regolith has 0.18."""
    pytest.importorskip("torch", reason="PyTorch is not installed")
    printed = run(
        "train_segmentation.py", "--size=64", "--steps=120", "--test-frames=16", "--least-iou=0.6", folder=tmp_path
    )
    found = re.search(r"rock (\d\.\d+), sky", printed)
    assert found and float(found[1]) > 0.25, printed
    assert (tmp_path / "predictions.png").stat().st_size > 1000


def test_training_takes_a_finished_dataset(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed")
    words = ["dataset", "--preset=train_dr", "--size=32", "--count=8", "--samples=1", "--out=data", "-q"]
    subprocess.run([sys.executable, "-m", "regolith_render", *words], cwd=tmp_path, check=True, timeout=300)
    printed = run(
        "train_segmentation.py", "--data=data", "--size=32", "--steps=3", "--test-frames=2", folder=tmp_path
    )
    assert "step    3: loss" in printed


def test_rerun_gets_camera_images_and_mesh(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    run("view_in_rerun.py", "--size=64", "--frames=2", "--save=moon.rrd", folder=tmp_path)
    rerun = [sys.executable, "-m", "rerun", "rrd"]
    subprocess.run([*rerun, "verify", "moon.rrd"], cwd=tmp_path, check=True, timeout=120)
    printed = subprocess.run(
        [*rerun, "print", "-v", "moon.rrd"], cwd=tmp_path, check=True, timeout=120, capture_output=True, text=True
    ).stdout
    for entity in ("world/mesh", "world/camera/image/rgb", "world/camera/image/classes", "world/camera/image/depth"):
        assert entity in printed, printed
