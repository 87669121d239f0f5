"""What the tests share: the program beside which the package stands, and small renderers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

import regolith_render as rr

ADAPTER = os.environ.get("REGOLITH_TEST_ADAPTER", "cpu")
"""The adapter of the tests: a part of its name."""

# A shell ignores Ctrl-C for what it starts in the background, and so would all processes of the tests.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def program(*words: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Runs the command line of the package."""
    environment = {**os.environ, "WGPU_ADAPTER_NAME": ADAPTER}
    command = [sys.executable, "-m", "regolith_render", *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


def python(text: str, *words: str, limit_s: float = 120, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs a program in a process of its own."""
    command = [sys.executable, "-c", textwrap.dedent(text), *words]
    return subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=limit_s
    )


@pytest.fixture(scope="session")
def renderer() -> Iterator[rr.Renderer]:
    with rr.Renderer(preset="train_dr", size=64, adapter=ADAPTER) as opened:
        yield opened
