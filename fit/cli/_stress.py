"""`airlight stress` between the command line and the tables."""

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from model_jax._errors import printable

from ._options import JsonOption
from ._outputs import prepare_folder
from ._progress import computing, console

if TYPE_CHECKING:
    from ..stress._stress import Stress


def stress(
    out: Annotated[str, typer.Option("-o", "--out", metavar="DIR", help="Folder for the files.")],
    quick: Annotated[bool, typer.Option(help="A quarter of the cases, and few looks.")] = False,
    look: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOOK",
            help="Only this look, by its name or Python file; repeatable.",
        ),
    ] = None,
    fits: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Random fits [1000, quick 40].")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Of the random fits.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Stiff and extreme cases as tables: what float32 and float64 lose, and what fits then say.

    Exit code 1: some number is not finite, some loss has no name, or a fit that calls itself
    converged is far off.
    """
    folder = prepare_folder(out)
    with computing(keep=False) as step:
        from dataclasses import replace

        from ..stress._made import SEED
        from ..stress._plans import FULL, QUICK, Plan
        from ..stress._stress import run_stress

        plan = Plan.only(look) if look else QUICK if quick else FULL
        plan = plan if fits is None else replace(plan, fits=fits)
        found = run_stress(folder, plan, SEED if seed is None else seed, step)
    if as_json:
        print(json.dumps(found.to_dict(), allow_nan=False))
    else:
        _tell(found, out)
    if found.broken:
        raise SystemExit(1)


def _tell(found: "Stress", out: str) -> None:
    """For people: how many cases ended how, and what is broken."""
    from ..stress._words import tables, verdicts

    counted = sorted(verdicts(found.numbers).items())
    _print_table(("where", "verdict", "cases"), [(*key, str(many)) for key, many in counted])
    if found.random:
        random = tables(found.numbers, found.fits, found.random)[-1]
        _print_table(random.columns, random.rows)
    said = console()
    for row in found.broken:
        said.print(f"broken: {row.case}: {row.note}", style="yellow", markup=False, highlight=False)
    names = "bench.html, stress.csv, stress_fits.csv, stress_random.csv, stress.json"
    said.print(f"{printable(out)}/{names}", markup=False)


def _print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in columns:
        table.add_column(name)
    for row in rows:
        table.add_row(*row)
    console().print(table)
