"""What mkdocs does not do by itself: the first page, the API reference, links out of ``docs/``.

Hooks of ``mkdocs.yml``. mibvh is not imported: its public names are read from its source.
"""

import ast
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
GENERATED = Path("docs/results")  # tables of studies; they need not stand in the nav

#: Pages of the API reference: file, title, and the modules whose names they hold. A public
#: name stands on the page of the longest module that its home begins with.
PAGES = {
    "scenes": ("Scenes and triangles", ["mibvh.scene", "mibvh.loading", "mibvh.triangles"]),
    "trees": (
        "Trees",
        [
            f"mibvh.{m}"
            for m in (
                "tree",
                "layouts",
                "comparison",
                "wide_tree",
                "collapsing",
                "quantise",
                "audit",
            )
        ],
    ),
    "builders": ("Builders", ["mibvh.builders"]),
    "metrics": ("Metrics", ["mibvh.metrics"]),
    "predictors": ("Predictors", ["mibvh.metrics.predictor"]),
    "rays": ("Rays", ["mibvh.rays"]),
    "traversal": ("Traversal", ["mibvh.traversal"]),
    "studies": ("Studies", ["mibvh.studies"]),
    "plot": ("Pictures", ["mibvh.plot"]),
    "mitsuba": ("In Mitsuba", ["mibvh.mitsuba"]),
    "other": ("Other", ["mibvh"]),
}
#: Objects that users need and ``import mibvh`` does not give.
MORE = {
    "metrics": [
        "mibvh.metrics.registry.Metric",
        "mibvh.metrics.registry.Quantity",
        "mibvh.metrics.registry.add_metric",
        "mibvh.metrics.lines.line_costs",
    ],
    "predictors": [
        "mibvh.metrics.predictors.registry.Predictor",
        "mibvh.metrics.predictors.registry.add_predictor",
    ],
    "trees": ["mibvh.comparison.difference_figure"],
    "builders": ["mibvh.builders.plain.plain_sweep"],
    "plot": [
        "mibvh.plot.wireframe.wireframe",
        "mibvh.plot.slices.overlap_slice",
        "mibvh.plot.overview.overview",
        "mibvh.plot.charts.by_depth",
        "mibvh.plot.charts.leaf_sizes",
        "mibvh.plot.charts.sah_epo",
        "mibvh.plot.charts.predicted_measured",
    ],
    "mitsuba": ["mibvh.mitsuba"],
}

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s]+)(#[^)]*)?\)")
_ROLE = re.compile(r":(?:func|class|meth|mod|data|attr|exc):<code>~?([\w.]+)</code>")


def public_names() -> dict[str, str]:
    """Name and full path of everything that ``import mibvh`` gives."""
    for node in ast.parse((ROOT / "mibvh/__init__.py").read_text()).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "_PUBLIC":
            return {name: f"{home}.{name}" for name, home in ast.literal_eval(node.value).items()}
    raise ValueError("mibvh/__init__.py declares no _PUBLIC")


def api_pages() -> dict[str, str]:
    """Markdown of the API reference, by file; pages without a name are left out."""
    paths: dict[str, list[str]] = {page: [] for page in PAGES}
    for name, path in public_names().items():
        if name == "plot":
            continue  # a module; its functions stand in MORE
        fits = [
            (len(module), page)
            for page, (_, modules) in PAGES.items()
            for module in modules
            if f"{path}.".startswith(f"{module}.")
        ]
        paths[max(fits)[1]].append(path)
    for page, more in MORE.items():
        paths[page] += [path for path in more if path not in paths[page]]
    return {
        f"api/{page}.md": f"# {PAGES[page][0]}\n\n" + "\n\n".join(f"::: {p}" for p in found) + "\n"
        for page, found in paths.items()
        if found
    }


def on_config(config: Any) -> Any:
    """Complete the nav: pages that exist and only those, tables of results, the API reference."""
    named = re.findall(r"[\w-]+\.md", str(config.nav))
    others = sorted({path.name for path in (ROOT / "docs").glob("*.md")} - set(named))
    for section in config.nav:
        for title, entries in section.items() if isinstance(section, dict) else []:
            if title == "API":
                entries[:] = list(api_pages())
            elif title == "Results":
                tables = sorted((ROOT / GENERATED).glob("*.md"))
                entries += [f"results/{path.name}" for path in tables]
            else:
                entries[:] = [page for page in entries if (ROOT / "docs" / page).exists()]
                if title == "Guides":
                    entries += others
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages."""
    from mkdocs.structure.files import File  # the tests read the API's pages without mkdocs

    readme = (ROOT / "README.md").read_text()
    pages = {"index.md": readme.replace("](docs/", "]("), **api_pages()}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Name files outside of ``docs/`` instead of linking to them."""
    folder = (ROOT / "docs" / page.file.src_uri).parent

    def named(match: re.Match[str]) -> str:
        image, text, target, _ = match.groups()
        path = (folder / target).resolve()
        if image or "://" in target or (path.is_relative_to(ROOT / "docs") and path.exists()):
            return match[0]
        if page.file.src_uri == "index.md" and (ROOT / target).exists():
            return f"{text} (`{target}`)" if text != target else f"`{target}`"
        if path.is_relative_to(ROOT) and path.exists():
            return f"`{path.relative_to(ROOT)}`"
        return match[0]

    return _LINK.sub(named, markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Make links of the roles in docstrings, such as :func:`mibvh.sah`."""
    public = public_names()

    def link(match: re.Match[str]) -> str:
        name = match[1].removeprefix("mibvh.")
        first, _, rest = name.partition(".")
        path = public.get(first, "") and public[first] + (f".{rest}" if rest else "")
        shown = f"<code>{match[1]}</code>"
        target = path or match[1]
        return f'<autoref optional identifier="{target}">{shown}</autoref>'

    return _ROLE.sub(link, html)
