"""Commands that list builders, experiments, predictors and notebooks, and check this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mibvh.cli.exits import REFUSED
from mibvh.cli.options import Json
from mibvh.cli.printing import print_json, print_result, print_table


def builders(as_json: Json = False) -> None:
    """List the builders, their sources and options."""
    from mibvh.builders import all_names, get

    described = [get(name).describe() for name in all_names()]
    if as_json:
        print_json({"builders": described})
        return
    print_table(
        ("builder", "what it does", "source", "options (default)"),
        (
            (
                entry["name"],
                entry["summary"],
                entry["source"],
                ", ".join(f"{k} ({v['default']})" for k, v in entry["options"].items()),
            )
            for entry in described
        ),
    )


def experiments(as_json: Json = False) -> None:
    """List the experiments of a study, and what each adds."""
    from mibvh.studies import EXPERIMENTS

    if as_json:
        listed = [{"name": name, "summary": summary} for name, summary in EXPERIMENTS.items()]
        print_json({"experiments": listed})
        return
    print_result(EXPERIMENTS, as_json)


def predictors(as_json: Json = False) -> None:
    """List the predictors of cost, their formulas and free parameters."""
    from mibvh.metrics.predictors import predictors as known

    if as_json:
        listed = [{"name": p.name, "formula": p.formula, "free": p.free} for p in known()]
        print_json({"predictors": listed})
        return
    print_table(
        ("predictor", "formula", "free parameters"), ((p.name, p.formula, p.free) for p in known())
    )


def notebooks(
    output: Annotated[Path, typer.Option("-o", "--output", help="folder to copy them into")],
    as_json: Json = False,
) -> None:
    """Copy mibvh's notebooks into a folder to run them."""
    from mibvh.bundled import copy_notebooks

    copied = [str(path) for path in copy_notebooks(output)]
    if as_json:
        print_json({"notebooks": copied})
        return
    typer.echo("\n".join(copied))


def doctor(as_json: Json = False) -> None:
    """Say what this machine has and what to install."""
    from mibvh.environment import doctor as look

    state = look()
    if as_json:
        print_json(state)
    else:
        environment = state.pop("environment", {})
        advice = "; ".join(state["advice"]) or "none needed"
        print_result({**state, "advice": advice, **environment}, as_json)
    if not state["ready"]:
        raise typer.Exit(REFUSED)
