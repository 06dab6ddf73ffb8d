"""One table, three forms: JSON for programs, Markdown for people, LaTeX for papers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Json = dict[str, Any]


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes:
        title: what it shows.
        note: how to read a cell.
        head: of the columns; the first is that of the row labels.
        rows: label and cells; a row of one cell separates groups.
    """

    title: str
    note: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """As GitHub shows it."""
        padded = [[*row, *[""] * (len(self.head) - len(row))] for row in self.rows]
        lines = [list(self.head), ["---"] * len(self.head), *padded]
        body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return f"## {self.title}\n\n{self.note}\n\n{body}\n"

    def latex(self) -> str:
        """A ``table`` with ``booktabs`` rules."""
        columns = "l" + "c" * (len(self.head) - 1)
        lines = [
            r"\begin{table}",
            r"\centering",
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            _latex_row(self.head),
            r"\midrule",
            *(self._latex_line(row) for row in self.rows),
            r"\bottomrule",
            r"\end{tabular}",
            rf"\caption{{{_escaped(f'{self.title}. {self.note}')}}}",
            r"\end{table}",
        ]
        return "\n".join(lines) + "\n"

    def _latex_line(self, row: Sequence[str]) -> str:
        if len(row) > 1:
            return _latex_row(row)
        return rf"\midrule \multicolumn{{{len(self.head)}}}{{l}}{{{_escaped(row[0])}}} \\"


def write(out: Path, results: Json, tables: Sequence[Table]) -> str:
    """Write ``out`` (JSON), and beside it ``.md`` and ``.tex``; returns the Markdown.

    Args:
        out: path of the JSON file.
        results: settings and numbers; strict JSON, no NaN.
        tables: the same numbers for people.
    """
    text = "\n".join(table.markdown() for table in tables)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")
    out.with_suffix(".md").write_text(text)
    out.with_suffix(".tex").write_text("\n".join(table.latex() for table in tables))
    return text


def pose_cell(rotation_deg: float, translation_m: float) -> str:
    """``deg / m``."""
    return f"{rotation_deg:.1f} / {translation_m:.2f}"


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(map(_escaped, cells)) + r" \\"


def _escaped(text: str) -> str:
    for symbol in "&%_#":
        text = text.replace(symbol, f"\\{symbol}")
    return text.replace(">=", r"$\geq$").replace("<", "$<$").replace(">", "$>$")
