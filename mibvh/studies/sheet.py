"""A table for people: the one form from which the report, Markdown, LaTeX and CSV are written."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

#: Rows that a page shows unfolded.
_LONG = 15
#: What stands where there is no value.
_NONE = "–"
#: What LaTeX takes for commands, and letters and signs that it does not know by themselves.
_LATEX = str.maketrans({
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    **{sign: "\\" + sign for sign in "&%$#_{}"},
    "α": r"$\alpha$", "β": r"$\beta$", "σ": r"$\sigma$", "−": "$-$", "±": r"$\pm$",
    "–": "--", "×": r"$\times$", "≥": r"$\geq$", "≤": r"$\leq$", "√": r"$\surd$", "²": "$^2$",
    "°": r"$^\circ$", "∞": r"$\infty$",
})  # fmt: skip


class Cell(NamedTuple):
    """A value as it is read: its text, what it sorts by, its error, whether it is the best."""

    text: str
    sort: float | str
    error: str
    best: bool


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Sheet:
    """A table for people.

    Attributes
    ----------
    name : str
        Of its files; no spaces.
    section : str
        Heading under which it stands; sheets of a section follow each other.
    title : str
    frame : DataFrame
        The values. The first column says what a row is about; column names are the headings.
    note : str
        What a reader needs to know, in a sentence or two.
    formats : dict of str to str
        How the numbers of a column are written, such as ``.3f``; text stays as it is.
    help : dict of str to str
        What a column is, in a few words.
    errors : dict of str to str
        Columns that are not shown by themselves but behind another, as its relative error.
    best : tuple of str
        Columns of which the smallest value is the best.
    unfolded : bool
        Whether a page shows it at once however many rows it has.
    """

    name: str
    section: str
    title: str
    frame: pd.DataFrame
    note: str = ""
    formats: Mapping[str, str] = dataclasses.field(default_factory=dict)
    help: Mapping[str, str] = dataclasses.field(default_factory=dict)
    errors: Mapping[str, str] = dataclasses.field(default_factory=dict)
    best: tuple[str, ...] = ()
    unfolded: bool = False

    @property
    def heads(self) -> list[str]:
        """Headings of the columns that are shown."""
        return [c for c in self.frame.columns if c not in self.errors.values()]

    @property
    def long(self) -> bool:
        """Whether it has so many rows that a page shows it folded."""
        return not self.unfolded and len(self.frame) > _LONG

    def is_text(self, head: str) -> bool:
        """Whether a column holds words rather than numbers."""
        return not pd.api.types.is_numeric_dtype(self.frame[head])

    def rows(self) -> list[list[Cell]]:
        """The cells, row by row."""
        least = {head: self.frame[head].min() for head in self.best}
        return [
            [self._cell(head, row, least.get(head)) for head in self.heads]
            for row in self.frame.to_dict("records")
        ]

    def _cell(self, head: str, row: dict[Any, Any], least: float | None) -> Cell:
        value = row[head]
        if isinstance(value, (bool, np.bool_)):
            return Cell("yes" if value else "no", float(value), "", False)
        if isinstance(value, str):
            return Cell(value, value, "", False)
        if value is None or np.isnan(value):
            return Cell(_NONE, "", "", False)
        if np.isinf(value):
            return Cell("∞" if value > 0 else "−∞", float(np.nan_to_num(value)), "", False)
        error = row[self.errors[head]] if head in self.errors else np.nan
        return Cell(
            format(value, self.formats.get(head, "g")),
            float(value),
            f"±{error:.1%}" if np.isfinite(error) else "",
            least is not None and value == least,
        )

    def markdown(self) -> str:
        """As a Markdown table under a heading."""
        heads = self.heads
        marks = ["---" if self.is_text(head) else "---:" for head in heads]
        lines = [heads, marks, *([cell.text for cell in row] for row in self.rows())]
        table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return "\n\n".join(part for part in (f"### {self.title}", self.note, table) if part) + "\n"

    def latex(self) -> str:
        """As a LaTeX table in the manner of the package ``booktabs``; the best values are bold."""
        columns = "".join("l" if self.is_text(head) else "r" for head in self.heads)
        caption = " ".join(part for part in (f"{self.title}.", self.note) if part)
        head = " & ".join(map(_latex, self.heads))
        rows = [
            " & ".join(rf"\textbf{{{_latex(c.text)}}}" if c.best else _latex(c.text) for c in row)
            for row in self.rows()
        ]
        body = " \\\\\n".join(rows)
        return (
            "% needs \\usepackage{booktabs}\n"
            "\\begin{table}\n\\centering\n"
            f"\\caption{{{_latex(caption)}}}\n\\label{{tab:{self.name}}}\n"
            f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{head} \\\\\n\\midrule\n"
            f"{body} \\\\\n\\bottomrule\n"
            "\\end{tabular}\n\\end{table}\n"
        )


def _latex(text: str) -> str:
    return text.translate(_LATEX)
