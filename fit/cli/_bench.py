"""`airlight bench` between the command line and the measuring: what is asked, and what is said."""

import json
from typing import Annotated, Literal

import typer

from model_jax._errors import InputError, printable

from ._options import JsonOption
from ._outputs import prepare_folder
from ._progress import computing, console

CostAxis = Literal["time", "evaluations", "bytes"]


def bench(
    out: Annotated[str, typer.Option("-o", "--out", metavar="DIR", help="Folder for the files.")],
    quick: Annotated[
        bool, typer.Option(help="Small pictures and fewer settings: a minute.")
    ] = False,
    scene: Annotated[
        list[str] | None,
        typer.Option(metavar="SCENE", help="A scene file, in place of those built in; repeatable."),
    ] = None,
    photo: Annotated[
        str | None, typer.Option(metavar="PHOTO", help="Of the first scene, in place of its own.")
    ] = None,
    axis: Annotated[CostAxis, typer.Option(help="What charts count costs in.")] = "time",
    as_json: JsonOption = False,
) -> None:
    """Measure error against run time: renders, the combine step, fits and their peers."""
    scenes = scene or ()
    if photo is not None and not scenes:
        raise InputError("--photo: needs the --scene that it was taken in")
    folder = prepare_folder(out)
    with computing(keep=False, bar=True) as step:
        from ..bench._frontier import run_bench
        from ..bench._plans import FULL, QUICK

        found = run_bench(folder, QUICK if quick else FULL, scenes, photo, axis, step)
    if as_json:
        print(json.dumps(found.to_dict(), allow_nan=False))
        return
    from rich.table import Table

    from ..bench._page import who_is_first

    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("fit", "error at most", "airlight", "peers"):
        table.add_column(name)
    for row in who_is_first(found.points):
        style = "yellow" if row["peer_wins"] else None
        table.add_row(row["fit"], row["level"], row["ours"], row["rival"], style=style)
    said = console()
    said.print(table)
    for line in found.left_out:
        said.print(f"left out: {line}", style="dim", markup=False, highlight=False)
    said.print(f"{printable(out)}/bench.html, frontier.csv, .json, .png, .svg", markup=False)
