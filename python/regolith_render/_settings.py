"""Arguments as the native module takes them, checked; and the environment while a device is opened."""

from __future__ import annotations

import ctypes
import json
import operator
import os
import re
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from . import _native

Knobs = Mapping[str, Any]
"""Values of knobs by dotted name: a number, a text, a list, or a distribution as in `{"uniform": [5, 40]}`."""

MAX_SEED = 2**64 - 1
MAX_FRAMES = 2**32
"""Most frames of a dataset."""
MAX_PREFETCH = 1000
MAX_THREADS = 256
MAX_SIDE = 2**16


def refused(name: str, value: object, allowed: str, *, knob: str | None = None) -> _native.ConfigError:
    """The error for an argument."""
    try:
        shown = repr(value)
    except ValueError:  # Python writes no integers of thousands of digits.
        shown = "an integer of too many digits"
    error = _native.ConfigError(f"{name} = {shown}: {allowed}")
    error.knob, error.value, error.allowed = knob, shown, allowed
    return error


def whole(name: str, value: object, low: int, high: int) -> int:
    """A whole number from `low` to `high`; NumPy's integers and tensors of one are such as well."""
    allowed = f"a whole number from {low} to {high} is expected"
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise refused(name, value, allowed) from None
    if isinstance(value, (bool, np.bool_)) or not low <= number <= high:
        raise refused(name, value, allowed)
    return number


def number(name: str, value: object, low: float = -np.inf, high: float = np.inf) -> float:
    """A finite number from `low` to `high`; NumPy's numbers and tensors of one are such as well, texts and truth values are not."""
    try:
        found = float("nan") if isinstance(value, (str, bytes, bytearray, bool, np.bool_)) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        found = float("nan")
    if not (np.isfinite(found) and low <= found <= high):
        bounds = f" from {low:g} to {high:g}" if np.isfinite(low) else ""
        raise refused(name, value, f"a number{bounds} is expected")
    return found


def text(name: str, value: object) -> str:
    """A text that UTF-8 has."""
    if not isinstance(value, str):
        raise refused(name, value, "a text is expected")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise refused(name, value, "a text without lone surrogates is expected") from None
    return value


def named(name: str, value: object) -> str:
    """A text that is not empty."""
    if not (found := text(name, value)).strip():
        raise refused(name, value, "a part of a name is expected")
    return found


def truth(name: str, value: object) -> bool:
    """A truth value."""
    if not isinstance(value, (bool, np.bool_)):
        raise refused(name, value, "True or False is expected")
    return bool(value)


def path_of(name: str, value: str | bytes | os.PathLike[str]) -> str:
    """The path of a file; bytes of it that are no text are lone surrogates, as in `os.fsdecode`."""
    try:
        path = os.fsdecode(value)
        os.fsencode(path)
    except (TypeError, UnicodeError):
        raise refused(name, value, "the path of a file is expected") from None
    return path


def seed_of(value: object) -> int:
    return whole("seed", value, 0, MAX_SEED)


def size_of(value: Any) -> tuple[int, int]:
    """Width and height, pixels, of one number or a pair."""
    sides = value if _is_list(value) else (value, value)
    width: object
    height: object
    try:
        width, height = sides
    except (TypeError, ValueError):
        raise refused("size", value, "(width, height) in pixels is expected, or one number for both") from None
    return whole("size", width, 1, MAX_SIDE), whole("size", height, 1, MAX_SIDE)


def _is_list(value: object) -> bool:
    """Whether it has items by number: texts and NumPy's arrays of no dimension have none."""
    try:
        len(value)  # type: ignore[arg-type]
    except TypeError:
        return False
    return hasattr(value, "__getitem__") and not isinstance(value, (str, bytes, Mapping))


def names_of(name: str, value: object) -> list[str]:
    """Names of a text with commas between them, or of a sequence of texts."""
    if value is None:
        return []
    listed = value.split(",") if isinstance(value, str) else value
    try:
        names = list(listed)  # type: ignore[call-overload]
    except TypeError:
        names = [None]
    if not all(isinstance(item, str) for item in names):
        raise refused(name, value, "a name is expected, or several with commas between them, or a list of names")
    return [text(name, item).strip() for item in names]


def outputs_of(value: object) -> list[str]:
    """Names of outputs, one at least."""
    names = names_of("outputs", value)
    if not any(names):
        raise refused("outputs", value, f"at least one name is expected, of {', '.join(_native.outputs())} and all")
    return names


def samples_of(value: object) -> int:
    """Samples of a pixel."""
    samples = whole("samples", value, 1, 16)
    if samples not in (1, 4, 16):
        raise refused("samples", value, "1, 4 or 16 is expected")
    return samples


def plain(set: Knobs | None) -> dict[str, Any]:
    """Values of knobs in Python's own types."""
    if set is not None and not isinstance(set, Mapping):
        raise refused("set", set, 'a mapping of knobs is expected, as in {"sun.elevation_deg": 12}')
    try:
        return _with_one_azimuth({str(name): _plain(str(name), value) for name, value in (set or {}).items()})
    except RecursionError:
        raise refused("set", set, "values of finite depth are expected") from None


def _with_one_azimuth(knobs: dict[str, Any]) -> dict[str, Any]:
    """The same without one of the sun's two azimuths where they agree, as in the knobs of a record, which has the other one computed."""
    names = azimuth, relative, yaw = "sun.azimuth_deg", "sun.relative_azimuth_deg", "camera.yaw_deg"
    if not all(isinstance(knobs.get(name), float) for name in names):
        return knobs
    turned = (knobs[azimuth] - knobs[yaw]) % 360.0
    if knobs[azimuth] == (knobs[yaw] + knobs[relative]) % 360.0:
        return {name: value for name, value in knobs.items() if name != azimuth}
    if knobs[relative] == (turned - 360.0 if turned > 180.0 else turned):
        return {name: value for name, value in knobs.items() if name != relative}
    return knobs


def document(set: Knobs | None) -> str:
    """Values of knobs as TOML."""
    knobs = plain(set)
    try:
        return "".join(f"{_key(name)} = {_toml(value)}\n" for name, value in knobs.items())
    except RecursionError:
        raise refused("set", set, "values of finite depth are expected") from None


def _key(name: str) -> str:
    """A dotted name; what is no name becomes one that no knob has."""
    parts = name.split(".")
    return ".".join(part if re.fullmatch(r"[A-Za-z0-9_-]+", part) else _text(part) for part in parts)


def _text(value: str) -> str:
    """A text as TOML, which knows no surrogates; its delete character is escaped."""
    return json.dumps(text("set", value), ensure_ascii=False).replace("\x7f", "\\u007f")


def _plain(knob: str, value: object) -> Any:
    """A value of a knob in Python's own types."""
    if isinstance(value, Mapping):
        return {str(key): _plain(knob, item) for key, item in value.items()}
    if isinstance(value, str):
        return str.__str__(value)
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return _whole_or_float(knob, int(value))
    if isinstance(value, (float, np.floating)):
        return float(value)
    if _is_list(value) and isinstance(value, (Sequence, np.ndarray)):
        return [_plain(knob, item) for item in value]
    expected = "a number, a text, a list or a distribution is expected; this is no value of a knob"
    raise refused(knob, value, expected, knob=knob)


def _whole_or_float(knob: str, value: int) -> int | float:
    """Whole numbers of TOML have 64 bits; larger ones are out of the range of every knob, which is the error that names it."""
    try:
        return value if -(2**63) <= value < 2**63 else float(value)
    except OverflowError:
        raise refused(knob, value, "a number within the range of the knob is expected", knob=knob) from None


def _toml(value: Any) -> str:
    """A plain value as TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, str):
        return _text(value)
    return str(value).lower() if isinstance(value, bool) else repr(value)


_opening = threading.Lock()


def _new_lock() -> None:
    """In a forked child the lock may be held by a thread that does not exist there."""
    global _opening
    _opening = threading.Lock()


if hasattr(os, "register_at_fork"):
    # No process is forked while a device is opened: the locks of loader and drivers would never be released in the child.
    os.register_at_fork(
        before=lambda: _opening.acquire(), after_in_parent=lambda: _opening.release(), after_in_child=_new_lock
    )


@contextmanager
def opening() -> Iterator[None]:
    """While a device is opened: one at a time, and with the displays of the environment hidden. Drivers look for displays to choose a
    GPU by, may wait for one without a limit, and complain where there is none; frames need none."""
    with _opening:
        before = {name: os.environ.get(name) for name in ("DISPLAY", "WAYLAND_SOCKET", "WAYLAND_DISPLAY")}
        hide_displays()
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


_trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None


def release_memory() -> None:
    """Gives memory that is free back to the system. glibc keeps it for each thread that there was: without this, a process that starts
    many streams, each with threads of its own, grows for a hundred of them."""
    if _trim is not None:
        _trim(0)


def hide_displays() -> None:
    """Hides the displays of this process from drivers."""
    os.environ.pop("DISPLAY", None)
    os.environ.pop("WAYLAND_SOCKET", None)
    os.environ["WAYLAND_DISPLAY"] = "/dev/null"
