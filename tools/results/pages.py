"""The pages of tables under ``docs/results``: which tables stand on which page, and their heads."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

from mibvh.files import write_text
from mibvh.studies.record.sheet import Sheet

#: Said on a page whose tables were not made anew.
OLD = "**Of version 0.1:** these tables were not measured again since."
#: The remark of version 0.1 that new tables have no need of.
_REMARK = re.compile(r"\*\*EPO of split trees is too small in these tables\.\*\*.*?\n\n", re.S)


@dataclasses.dataclass(frozen=True)
class Page:
    """A page of tables.

    Attributes
    ----------
    file, title : str
    sheets : tuple of str
        Names of the tables; one that ends in ``*`` stands for all that begin so.
    needs : str
        The experiment without which the page has no tables.
    """

    file: str
    title: str
    sheets: tuple[str, ...]
    needs: str = "prediction"


PAGES = (
    Page("claims", "The paper's claims, judged", ("claims", "paper-scenes")),
    Page(
        "correlations",
        "How well each predictor correlates",
        ("overview", "pooled-*", "finite-rays", "level*", "r", "r-others", "shared-weights"),
    ),
    Page("builders", "The builders compared", ("builders", "sah-over-best", "worst-case", "where")),
    Page("rotation", "Rotated scenes", ("rotation-scenes", "rotation-builders"), "rotation"),
    Page(
        "sensitivity", "Other leaf sizes, bounces and viewpoints", ("sensitivity*",), "sensitivity"
    ),
    Page(
        "times",
        "Times, and how well they are known",
        (
            "simd-deviation",
            "warp-*",
            "step-costs",
            "cost-constants",
            "stopwatch",
            "noise",
            "seconds",
        ),
    ),
    Page("trees", "All trees", ("trees",)),
)


def on_page(page: Page, sheets: Sequence[Sheet]) -> list[Sheet]:
    """Return the tables of a page, in its order."""
    found = []
    for wanted in page.sheets:
        begins = wanted.removesuffix("*")
        found += [
            sheet
            for sheet in sheets
            if (sheet.name.startswith(begins) if wanted.endswith("*") else sheet.name == wanted)
        ]
    return found


def tables_of(page: Page, sheets: Sequence[Sheet]) -> str:
    """Return the tables of a page as Markdown, each under a heading of the second level."""
    return "\n".join(re.sub("^###", "##", sheet.markdown()) for sheet in on_page(page, sheets))


def page_text(page: Page, sheets: Sequence[Sheet], said: str) -> str:
    """Return a page.

    Parameters
    ----------
    page : Page
    sheets : sequence of Sheet
        Of all pages.
    said : str
        What was measured, when and where, in a sentence or two.
    """
    return (
        f"# {page.title}\n\n{said} [results.md](../results.md) has the command and what the tables "
        f"mean.\n\n{tables_of(page, sheets)}"
    )


def marked_as_old(text: str) -> str:
    """Return a page of version 0.1 with a line that says so, once."""
    if OLD in text:
        return text
    head, _, rest = text.partition("\n\n")
    return f"{head}\n\n{OLD}\n\n{rest}"


def write_pages(
    docs: Path, sheets: Sequence[Sheet], experiments: set[str], said: str
) -> dict[str, bool]:
    """Write the pages that there are tables for, and mark the others as old.

    Parameters
    ----------
    docs : Path
    sheets : sequence of Sheet
    experiments : set of str
        Those that were run on all scenes of the study.
    said : str
        As of :func:`page_text`.

    Returns
    -------
    dict of str to bool
        Of each page, whether it is new.
    """
    written = {}
    for page in PAGES:
        path = docs / "results" / f"{page.file}.md"
        new = page.needs in experiments
        if new:
            write_text(path, page_text(page, sheets, said))
        elif path.exists():
            write_text(path, marked_as_old(path.read_text(encoding="utf-8")))
        written[page.file] = new
    return written
