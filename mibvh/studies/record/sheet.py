"""A table for people, which is written to the report, Markdown, LaTeX and CSV."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from mibvh.files import atomic_path
from mibvh.metrics.registry import DIGITS, Quantity

#: Shown in place of a missing value.
_NONE = "–"
#: Digits that :data:`DIGITS` shows.
_SIGNIFICANT = 3
#: Escapes for LaTeX: its special characters, and characters that its default fonts lack.
_LATEX = str.maketrans({
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    **{sign: "\\" + sign for sign in "&%$#_{}"},
    "α": r"$\alpha$", "β": r"$\beta$", "σ": r"$\sigma$", "−": "$-$", "±": r"$\pm$",
    "–": "--", "×": r"$\times$", "≥": r"$\geq$", "≤": r"$\leq$", "√": r"$\surd$", "²": "$^2$",
    "°": r"$^\circ$", "∞": r"$\infty$", "[": "{[}", "*": "{*}",  # behind a line's end, commands
})  # fmt: skip
#: Characters that Markdown reads as a table's edge, HTML, code, a link or emphasis.
_MARKDOWN = re.compile(r"[\\|<>`*\[\]]|(?<![^\W_])_|_(?![^\W_])|&(?=#?\w+;)")
#: Text that a spreadsheet reads as the beginning of a formula; a signed number is none.
_FORMULA = re.compile(r"[=@\t\r]|[+-](?!\d[\d.,]*\s?[%°×]?$)")


class Cell(NamedTuple):
    """A value as a table shows it.

    Attributes
    ----------
    text : str
    sort : float or str
        The key that its column is sorted by.
    error : str
        Its relative error, such as ``±0.5%``; empty if it has none.
    best : bool
        Whether it is the best of its column, by more than the errors.
    alarm : bool
        Whether it is unreliable, and marked as such.
    """

    text: str
    sort: float | str
    error: str = ""
    best: bool = False
    alarm: bool = False


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table for people.

    Attributes
    ----------
    key : str
        Name of the values in the frame.
    heading : str
        The key itself if this is empty.
    format : str
        Format of its numbers, such as ``.3f``, or :data:`DIGITS`; text is not formatted.
    help : str
        A short explanation.
    error : str
        Key of the relative error that is shown after each value. It has no column of its own in the
        table, but one in the data file.
    smaller_is_better : bool
        Whether the smallest value is marked as the best, if its lead exceeds the errors.
    alarm : str
        Key of the column that flags unreliable values.
    """

    key: str
    heading: str = ""
    format: str = "g"
    help: str = ""
    error: str = ""
    smaller_is_better: bool = False
    alarm: str = ""

    @property
    def head(self) -> str:
        """The heading, or the key if there is none."""
        return self.heading or self.key

    @classmethod
    def of(cls, quantity: Quantity, error: bool = False, alarm: str = "") -> Column:
        """Return the column of a quantity, with its error after the values on request."""
        return cls(
            key=quantity.name,
            heading=quantity.heading,
            format=quantity.format,
            help=quantity.help,
            error=quantity.error if error else "",
            smaller_is_better=quantity.smaller_is_better,
            alarm=alarm,
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Sheet:
    """A table for people.

    Attributes
    ----------
    name : str
        Name of its files, without spaces.
    section : str
        Heading of its section; the sheets of a section follow each other.
    title : str
    frame : DataFrame
        The values.
    columns : sequence of Column
        The columns that are shown. The first identifies the row.
    note : str
        An explanation in a sentence or two.
    glossary : dict of str to str
        Explanations of words in the cells, such as the names of predictors.
    unfolded : bool
        Whether a page shows all its rows at once, however many there are.
    """

    name: str
    section: str
    title: str
    frame: pd.DataFrame
    columns: Sequence[Column]
    note: str = ""
    glossary: Mapping[str, str] = dataclasses.field(default_factory=dict)
    unfolded: bool = False

    @property
    def keys(self) -> list[str]:
        """Keys of the columns."""
        return [column.key for column in self.columns]

    @property
    def values(self) -> pd.DataFrame:
        """The values for a data file, by heading, with errors in the last columns."""
        errors = {c.error: f"{c.head} error" for c in self.columns if c.error}
        names = {c.key: c.head for c in self.columns} | errors
        return self.frame[list(names)].rename(columns=names)

    def is_text(self, column: Column) -> bool:
        """Whether a column holds words rather than numbers."""
        return column.key in self._of_words

    @functools.cached_property
    def _of_words(self) -> frozenset[str]:
        """Keys of the columns that hold words."""
        numeric = pd.api.types.is_numeric_dtype
        return frozenset(key for key in self.keys if not numeric(self.frame[key]))

    def rows(self) -> list[list[Cell]]:
        """The cells, row by row."""
        return self._rows

    @functools.cached_property
    def _rows(self) -> list[list[Cell]]:
        """The cells, cached because the page, Markdown and LaTeX all need them."""
        least = {c: _clear_least(self.frame, c) for c in self.columns if c.smaller_is_better}
        keys = dict.fromkeys(k for c in self.columns for k in (c.key, c.error, c.alarm) if k)
        # to_dict("records") takes five times as long.
        rows = zip(*(self.frame[key].tolist() for key in keys), strict=True)
        return [
            [_cell(column, row, least.get(column)) for column in self.columns]
            for row in (dict(zip(keys, values, strict=True)) for values in rows)
        ]

    def markdown(self) -> str:
        """Return a Markdown table under a heading."""
        heads = [column.head for column in self.columns]
        marks = ["---" if self.is_text(column) else "---:" for column in self.columns]
        rows = ([literal(cell.text) for cell in row] for row in self.rows())
        lines = [[literal(head) for head in heads], marks, *rows]
        table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        parts = (f"### {literal(self.title)}", literal(self.note), table)
        return "\n\n".join(part for part in parts if part) + "\n"

    def latex(self) -> str:
        """Return a LaTeX table for the package ``booktabs``; the best values are bold."""
        columns = "".join("l" if self.is_text(column) else "r" for column in self.columns)
        caption = " ".join(part for part in (f"{self.title}.", self.note) if part)
        head = " & ".join(_latex(column.head) for column in self.columns)
        rows = [
            " & ".join(rf"\textbf{{{_latex(c.text)}}}" if c.best else _latex(c.text) for c in row)
            for row in self.rows()
        ]
        body = " \\\\\n".join(rows)
        label = re.sub("[^A-Za-z0-9.:@+-]", "-", self.name)
        return (
            "% needs \\usepackage{booktabs}\n"
            "\\begin{table}\n\\centering\n"
            f"\\caption{{{_latex(caption)}}}\n\\label{{tab:{label}}}\n"
            f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{head} \\\\\n\\midrule\n"
            f"{body} \\\\\n\\bottomrule\n"
            "\\end{tabular}\n\\end{table}\n"
        )


def _clear_least(frame: pd.DataFrame, column: Column) -> float | None:
    """Return the smallest value, or None if its lead over the next is within the errors.

    Equal values share the lead. With errors, the lead must exceed twice the standard error of the
    difference.
    """
    values = frame[column.key].to_numpy(np.float64)
    if not np.isfinite(values).any():
        return None
    least = float(np.nanmin(values))
    others = values > least
    if column.error and others.any():
        errors = values * np.nan_to_num(frame[column.error].to_numpy(np.float64))
        second = int(np.nanargmin(np.where(others, values, np.inf)))
        first = int(np.nanargmin(values))
        if not values[second] - least > 2 * np.hypot(errors[first], errors[second]):
            return None
    return least


def _cell(column: Column, row: dict[Any, Any], least: float | None) -> Cell:
    value = row[column.key]
    alarm = bool(column.alarm and row[column.alarm])
    if isinstance(value, bool | np.bool_):
        return Cell("yes" if value else "no", float(value), alarm=alarm)
    if isinstance(value, str):
        return Cell(value, value, alarm=alarm)
    if value is None or np.isnan(value):
        return Cell(_NONE, "", alarm=alarm)
    if np.isinf(value):
        return Cell("∞" if value > 0 else "−∞", float(np.nan_to_num(value)), alarm=alarm)
    error = row[column.error] if column.error else np.nan
    return Cell(
        _number(value, column.format),
        float(value),
        within(error) if np.isfinite(error) else "",
        least is not None and value == least and not alarm,
        alarm,
    )


def _number(value: float, form: str) -> str:
    if form != DIGITS:
        return format(value, form)
    power = math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(0, _SIGNIFICANT - 1 - power)}f}"


def within(error: float) -> str:
    """Format a relative error, such as ``±0.5%``."""
    return f"±{max(error, 1e-4):.{digits_of(error)}%}"


def digits_of(error: float) -> int:
    """Return the decimals of a percentage: an error that would round to 0 has one more."""
    return 1 if error >= 5e-4 else 2


def _latex(text: str) -> str:
    return " ".join(text.split()).translate(_LATEX)


def literal(text: str) -> str:
    """Escape text so that Markdown shows it literally."""
    return _MARKDOWN.sub(lambda found: "\\" + found[0], " ".join(text.split()))


def write_csv(frame: pd.DataFrame, path: str | os.PathLike[str]) -> None:
    """Write a table as CSV; text that a spreadsheet would run as a formula gets a ``'`` first.

    Parameters
    ----------
    frame : DataFrame
        May contain names that come from untrusted files.
    path : path
    """
    harmless = frame.rename(columns=_no_formula)
    for place, dtype in enumerate(harmless.dtypes):
        if not pd.api.types.is_numeric_dtype(dtype):
            harmless.isetitem(place, harmless.iloc[:, place].map(_no_formula))
    with atomic_path(path) as temporary:
        harmless.to_csv(temporary, index=False)


def _no_formula(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value
