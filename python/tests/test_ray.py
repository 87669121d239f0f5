"""Ray Data: the frames of a dataset, from the workers of a cluster."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator

import numpy as np
import pytest

ray = pytest.importorskip("ray", reason="Ray is not installed")
pytest.importorskip("ray.data", reason="Ray Data is not installed")

import regolith_render as rr  # noqa: E402
from conftest import ADAPTER  # noqa: E402
from regolith_render.ray import read_moon  # noqa: E402


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """A local Ray of two workers."""
    environment = {"RAY_DEDUP_LOGS": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
    os.environ.update(environment)
    ray.init(num_cpus=2, include_dashboard=False, logging_level="ERROR", object_store_memory=100 << 20)
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    context.execution_options.preserve_order = True
    yield
    ray.shutdown()


def test_workers_render_the_frames_of_the_dataset_in_order(cluster: None) -> None:
    options = {"outputs": ("rgb", "mask", "depth", "hdr"), "size": 32, "adapter": ADAPTER}
    data = read_moon("train_dr", 7, seed=5, first=3, frames_per_block=2, **options)
    rows = data.map(lambda row: {**row, "process": os.getpid()}).take_all()
    assert [row["index"] for row in rows] == list(range(3, 10))
    with rr.Renderer("train_dr", **options) as renderer:
        for row, frame in zip(rows, renderer.dataset_frames(5, 3, end=10), strict=True):
            assert row["seed"] == frame.meta["seed"]
            assert json.loads(row["record"])["knobs"] == frame.meta["knobs"]
            for name, array in frame.items():
                assert row[name].dtype == array.dtype and np.array_equal(row[name], array), name


def test_batches_are_arrays(cluster: None) -> None:
    data = read_moon("train_dr", 4, frames_per_block=2, size=(32, 24), adapter=ADAPTER)
    [batch] = data.iter_batches(batch_size=4)
    assert batch["rgb"].shape == (4, 24, 32, 3) and batch["mask"].shape == (4, 24, 32)


def test_a_wrong_setting_is_an_error_before_anything_runs(cluster: None) -> None:
    with pytest.raises(rr.ConfigError, match="train_dr"):
        read_moon("train_d", 4)
    with pytest.raises(ValueError, match="count = 0"):
        read_moon("train_dr", 0)
