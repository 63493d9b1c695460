"""The report is valid HTML: parsed strictly, and what a parser does not look at by hand."""

import re
from collections import Counter
from html.parser import HTMLParser

import pytest
from tinyhtml5.parser import HTMLParser as Strict

#: Roles that the specification of ARIA in HTML allows on an ``svg`` element itself.
SVG_ROLES = {None, "img", "none", "presentation", "graphics-document"}
WEIGHTS = {"normal", "bold", "bolder", "lighter", *(str(w) for w in range(100, 1000, 100))}
#: Elements that may not stand in each other: only one of them can be what a click means.
INTERACTIVE = {"a", "button", "input", "label", "select", "summary", "textarea"}


class Elements(HTMLParser):
    """All start tags of a page with their attributes, and the interactive elements around them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, list[tuple[str, str | None]], list[str]]] = []
        self._open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, attrs, list(self._open)))
        if tag in INTERACTIVE - {"input"}:
            self._open.append(tag)

    def handle_endtag(self, tag):
        if tag in self._open:
            self._open.remove(tag)


def complaints(page: str) -> list[str]:
    """What is wrong with a page, in words; empty if nothing is."""
    strict = Strict()
    strict.parse(page)
    found = [f"line {place[0]}: {code}" for place, code, _ in strict.errors]
    elements = Elements(page).found
    ids = Counter(value for _, attrs, _ in elements for name, value in attrs if name == "id")
    found += [f"id {name} {count} times" for name, count in ids.items() if count > 1]
    found += [f"id {name!r}" for name in ids if not name or re.search(r"\s", name)]
    for tag, attrs, around in elements:
        of = dict(attrs)
        if tag == "svg" and of.get("role") not in SVG_ROLES:
            found.append(f"svg: role {of['role']}")
        if of.get("font-weight", "normal") not in WEIGHTS:
            found.append(f"{tag}: font-weight {of['font-weight']}")
        if tag == "img" and "alt" not in of:
            found.append("img: no alt")
        if (of.get("href") or "").startswith("#") and of["href"][1:] not in ids:
            found.append(f"link to {of['href']}, which is not there")
        nested = set(around) - ({"label"} if tag == "input" else set())
        if tag in INTERACTIVE and nested:
            found.append(f"{tag} within {nested.pop()}")
    return found


def test_the_report_is_valid(small_study):
    assert complaints(small_study.report.read_text()) == []


HEAD = "<!DOCTYPE html><html lang=en><head><title>t</title></head><body>"


@pytest.mark.parametrize(
    "wrong",
    [
        "<p><div></p>",
        "<table><p>text</p></table>",
        "<a id=one>1</a><a id=one>2</a>",
        '<a id="a b">1</a>',
        '<p class="a" class="b">text</p>',
        '<svg role="group"></svg>',
        '<svg><text font-weight="650">t</text></svg>',
        '<img src="data:,">',
        '<a href="#nowhere">text</a>',
        '<button><a href="#">text</a></button>',
    ],
)
def test_errors_are_seen(wrong):
    assert complaints(f"{HEAD}<p>text</p></body></html>") == []
    assert complaints(f"{HEAD}{wrong}</body></html>")
