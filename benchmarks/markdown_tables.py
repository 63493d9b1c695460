"""Tables of Markdown: how all benchmarks print them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from mibvh.files import write_text


def table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterable[str]:
    """Lines of a table under its title: text in the first column, numbers in the others."""
    yield f"**{title}**"
    yield ""
    yield f"| {' | '.join(heads)} |"
    yield f"|---|{'---:|' * (len(heads) - 1)}"
    for row in rows:
        yield f"| {' | '.join(row)} |"
    yield ""


def printed(lines: Iterable[str], output: Path | None) -> None:
    """Print lines, and write them to a file if there is one."""
    text = "\n".join(lines)
    print(text)
    if output:
        write_text(output, text + "\n")
