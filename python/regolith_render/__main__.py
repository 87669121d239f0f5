"""The command line: `python -m regolith_render` and the script `regolith-render` are the same program."""

from __future__ import annotations

import signal
import sys

from . import _native
from ._settings import hide_displays


def main() -> int:
    """Runs the command line of this process and returns its exit status."""
    hide_displays()
    # Ctrl-C ends the program, or what its commands make of it; Python's own handler would wait for them.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _native.main(["regolith-render", *sys.argv[1:]], sys.executable)


if __name__ == "__main__":
    sys.exit(main())
