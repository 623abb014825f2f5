"""The README's rows on speed, as `examples/frontier/frontier.csv` has them.

python -m tests.frontier_rows     prints the table
"""

from fit._numbers import number
from fit.bench._page import milliseconds
from fit.bench._point import Point, read_points

from .data import REPOSITORY

FRONTIER = REPOSITORY / "examples" / "frontier"

NEAR = 1e-6
"""Of fits the quickest row of a method whose parameters are as near."""

RENDERS = (
    "raster, linear, 1280×1024",
    "mesh, linear, 1280×1024, 196000 triangles",
    "analytic, float32, 1280×1024",
    "raster, linear, 640×512",
)

COMBINES = (
    ("layers", "GLSL"),
    ("layers", "JAX float32"),
    ("layers", "JAX float32, with slopes"),
    ("layers", "a fit's pass, pixel by pixel"),
    ("air+density+saturation", "a fit's pass, pixel by pixel"),
    ("air+density+saturation+sun", "a fit's pass, pixel by pixel"),
    ("air+density+top+saturation+sun+upwelling+phase+ground", "a fit's pass, pixel by pixel"),
)

FITS = (
    ("synthetic", "layers", "airlight"),
    ("synthetic", "layers", "airlight lm, float64, moments"),
    ("synthetic", "layers", "SciPy trf"),
    ("synthetic", "layers", "optax L-BFGS"),
    ("synthetic", "layers", "optimistix LM"),
    ("EPIC", "layers", "airlight"),
    ("EPIC", "layers", "optimistix LM"),
    ("synthetic", "layers", "airlight, whole fit()"),
    ("synthetic", "layers", "airlight, first fit()"),
    ("march", "layers", "airlight fit, from file to fit.json"),
    ("synthetic", "layers", "airlight fit, from file to fit.json"),
)


def points() -> list[Point]:
    """All rows of the file."""
    return read_points(FRONTIER / "frontier.csv")


def chosen() -> list[Point]:
    """The README's rows."""
    every = points()
    found = [p for setting in RENDERS for p in every if (p.scene, p.setting) == ("paper", setting)]
    found += [
        p for key in COMBINES for p in every if (p.area, p.look, p.method) == ("combine", *key)
    ]
    for key in FITS:
        rows = [p for p in every if (p.area, p.scene, p.look, p.method) == ("fit", *key)]
        near = [p for p in rows if p.parameters is not None and p.parameters <= NEAR]
        whole = any(p.parameters is None for p in rows) or "whole" in key[-1]
        found += rows if whole else [min(near, key=lambda p: p.seconds or 0.0)]
    return found


def table() -> list[str]:
    """In Markdown."""
    lines = ["| row | time | from … to | error |", "|---|---:|---:|---:|"]
    for p in chosen():
        name = f"{p.area}, {p.scene}, {p.look}: {p.method}; {p.setting}"
        error = {"render": p.width_p999, "combine": p.light, "fit": p.parameters}[p.area]
        spread = f"{milliseconds(p.low)} … {milliseconds(p.high)}" if p.repeats > 1 else "one run"
        told = "" if error is None else number(error, 2)
        lines.append(f"| {name} | {milliseconds(p.seconds)} | {spread} | {told} |")
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
