"""The command line: `python -m regolith_render` and the script `regolith-render` are the same program."""

from __future__ import annotations

import os
import sys

from . import _native


def main() -> int:
    """Runs the command line of this process and returns its exit status."""
    # Drivers look for displays to choose a GPU by, and may wait for one without a limit; frames need none.
    for name in ("DISPLAY", "WAYLAND_SOCKET"):
        os.environ.pop(name, None)
    os.environ["WAYLAND_DISPLAY"] = "/dev/null"
    return _native.main(["regolith-render", *sys.argv[1:]], sys.executable)


if __name__ == "__main__":
    sys.exit(main())
