"""The examples of the documentation run as they stand there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cached_property
from pathlib import Path

import pytest

import regolith_render as rr
from conftest import ADAPTER

ROOT = Path(__file__).parents[2]
EXAMPLES = [
    example
    for page in ("README.md", "docs/python.md")
    for example in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)
    if "regolith_render" in example
]


def package_of(example: str) -> str:
    """The package that an example needs besides; empty for none."""
    return next((name for name in ("torch", "ray") if f"regolith_render.{name}" in example), "")


@pytest.mark.parametrize("number", range(len(EXAMPLES)), ids=lambda number: f"{package_of(EXAMPLES[number])}{number}")
def test_examples_run(number: int, tmp_path: Path) -> None:
    if package := package_of(EXAMPLES[number]):
        pytest.importorskip(package, reason=f"{package} is not installed")
    environment = {**os.environ, "WGPU_ADAPTER_NAME": ADAPTER}
    example = subprocess.run(
        [sys.executable, "-c", EXAMPLES[number]], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert example.returncode == 0, example.stderr


def public_names() -> list[str]:
    """What the package exports, and the public classes and functions of its modules that need other packages, by their sources."""
    names = list(rr.__all__)
    for module in ("torch", "ray"):
        source = (ROOT / "python" / "regolith_render" / f"{module}.py").read_text()
        names += re.findall(r"^(?:class|def) ([A-Za-z]\w*)", source, flags=re.MULTILINE)
    return names


@pytest.mark.parametrize("name", public_names())
def test_every_public_name_has_an_example(name: str) -> None:
    assert any(re.search(rf"\b{name}\b", example) for example in EXAMPLES), f"docs/python.md has no example of {name}"


@pytest.mark.parametrize("name", ["Camera", "Frame", "Renderer", "Scene", "Sun"])
def test_every_public_method_has_a_docstring_and_an_example(name: str) -> None:
    for method, member in vars(getattr(rr, name)).items():
        if method.startswith("_") or not (callable(member) or isinstance(member, (property, cached_property))):
            continue
        assert member.__doc__, f"{name}.{method}"
        page = (ROOT / "docs" / "python.md").read_text()
        assert re.search(rf"\.{method}\b", page), f"docs/python.md does not mention {name}.{method}"
