"""A table of measured values and their bounds."""

import sys
from dataclasses import dataclass, field


# Columns of the table are padded to this width at most.
MAX_COLUMN = 80


@dataclass
class Report:
    """Rows: case, quantity, measured value, bound, whether it holds."""

    rows: list[tuple[str, str, str, str, bool]] = field(default_factory=list)
    case: str = ""

    def _row(self, quantity: str, measured: str, bound: str, holds: bool) -> None:
        self.rows.append((self.case, quantity, measured, bound, holds))

    def at_most(self, quantity: str, measured: float, bound: float, unit: str = "") -> None:
        """Adds a value that must not exceed its bound; NaN fails."""
        self._row(quantity, f"{measured:.3g}{unit}", f"<= {bound:g}{unit}", bool(measured <= bound))

    def at_least(self, quantity: str, measured: float, bound: float, unit: str = "") -> None:
        """Adds a value that must not fall below its bound; NaN fails."""
        self._row(quantity, f"{measured:.6g}{unit}", f">= {bound:g}{unit}", bool(measured >= bound))

    def none(self, quantity: str, faults: list[str], of: int | str) -> None:
        """Adds a list of faults, which must be empty; `of` says how much was checked."""
        self._row(quantity, "; ".join(faults[:3]) if faults else str(of), "no fault", not faults and of != 0)

    def failed(self) -> list[tuple[str, str, str, str, bool]]:
        """The rows that do not hold."""
        return [row for row in self.rows if not row[-1]]

    def print(self) -> None:
        """Prints the table to stdout and failures to stderr."""
        widths = [min(max(len(row[column]) for row in self.rows), MAX_COLUMN) for column in range(4)]
        for row in self.rows:
            cells = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
            print("  ".join([*cells, "ok" if row[-1] else "FAILS"]))
        for case, quantity, measured, bound, _ in self.failed():
            print(f"tests/outside: {case}: {quantity}: {measured}, must be {bound}", file=sys.stderr)
