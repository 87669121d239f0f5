"""Measured values, each with the bound that it must keep."""

import sys
from dataclasses import dataclass, field


# Columns of the table are padded to this width at most.
WIDEST = 80


@dataclass
class Report:
    """Rows of a table: what was measured, its bound, whether it holds."""

    rows: list[tuple[str, str, str, str, bool]] = field(default_factory=list)
    case: str = ""

    def _row(self, what: str, measured: str, bound: str, holds: bool) -> None:
        self.rows.append((self.case, what, measured, bound, holds))

    def at_most(self, what: str, measured: float, bound: float, unit: str = "") -> None:
        """A number that may not exceed its bound; nan exceeds every bound."""
        self._row(what, f"{measured:.3g}{unit}", f"<= {bound:g}{unit}", bool(measured <= bound))

    def at_least(self, what: str, measured: float, bound: float, unit: str = "") -> None:
        """A number that may not fall below its bound."""
        self._row(what, f"{measured:.6g}{unit}", f">= {bound:g}{unit}", bool(measured >= bound))

    def none(self, what: str, faults: list[str], of: int | str) -> None:
        """A list of faults, which must be empty, among so many things looked at."""
        self._row(what, "; ".join(faults[:3]) if faults else str(of), "no fault", not faults and of != 0)

    def failed(self) -> list[tuple[str, str, str, str, bool]]:
        """The rows that do not hold."""
        return [row for row in self.rows if not row[-1]]

    def print(self) -> None:
        """The table on stdout, what fails on stderr."""
        widths = [min(max(len(row[column]) for row in self.rows), WIDEST) for column in range(4)]
        for row in self.rows:
            cells = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
            print("  ".join([*cells, "ok" if row[-1] else "FAILS"]))
        for case, what, measured, bound, _ in self.failed():
            print(f"tests/outside: {case}: {what}: {measured}, must be {bound}", file=sys.stderr)
