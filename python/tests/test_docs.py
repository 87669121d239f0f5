"""The examples of the documentation run as they stand there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ADAPTER

ROOT = Path(__file__).parents[2]
EXAMPLES = [
    example
    for page in ("README.md", "docs/python.md")
    for example in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)
    if "regolith_render" in example
]


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_run(number: int, tmp_path: Path) -> None:
    if "import torch" in EXAMPLES[number]:
        pytest.importorskip("torch", reason="PyTorch is not installed")
    environment = {**os.environ, "WGPU_ADAPTER_NAME": ADAPTER}
    example = subprocess.run(
        [sys.executable, "-c", EXAMPLES[number]], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert example.returncode == 0, example.stderr


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 5
