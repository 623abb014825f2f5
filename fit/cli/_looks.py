"""`airlight looks`: what each look is made of, as data and as text."""

from typing import Any

from model_jax import FIELDS, Look, Parameter, find_look, looks
from model_jax._composite import dims
from model_jax._look import light_of
from render_gl._looks import look_text

from .._numbers import number


def describe_looks(look: str | None = None) -> dict[str, Any]:
    """Plain JSON data of one look or of all, and of the fields that looks may ask for.

    Raises `InputError` for an unknown look, and for one with an error, its GLSL included.
    """
    kinds = looks() if look is None else {kind.NAME: kind for kind in (find_look(look),)}
    return {
        "looks": {name: _look(kind) for name, kind in kinds.items()},
        "fields": {
            name: {"meaning": field.meaning, "unit": field.unit} for name, field in FIELDS.items()
        },
    }


def _look(kind: type[Look]) -> dict[str, Any]:
    look_text(kind)  # without a twin it could not be drawn
    return {
        "light": light_of(kind),
        "needs": list(kind.NEEDS),
        "linear_in": list(kind.LINEAR_IN),
        "dims_what_lies_behind": dims(kind),
        "parameters": {name: _parameter(about) for name, about in kind.PARAMETERS.items()},
        "terms": {term: _term(kind, term) for term in kind.TERMS},
    }


def _term(kind: type[Look], term: str) -> dict[str, Any]:
    """What a term does, and the parameters that it brings."""
    needs = kind.TERM_NEEDS.get(term, ())
    known, added = (kind.with_terms(names).PARAMETERS for names in (needs, [*needs, term]))
    return {
        "meaning": kind.TERMS[term],
        "needs": list(needs),
        "parameters": {
            name: _parameter(about) for name, about in added.items() if name not in known
        },
    }


def _parameter(about: Parameter) -> dict[str, Any]:
    return {
        "meaning": about.meaning,
        "unit": about.unit,
        "lower": _finite(about.lower),
        "upper": _finite(about.upper),
        "default": _listed(about.default),
        "shape": about.shape,
        "mean_one": about.mean_one,
        "of": about.of,
        "source": about.source,
    }


def _with(needs: list[str]) -> str:
    return f" (with {', '.join(needs)})" if needs else ""


def _finite(bound: float) -> float | None:
    return bound if abs(bound) < float("inf") else None


def _listed(default: Any) -> Any:
    return list(default) if isinstance(default, tuple) else default


def looks_text(found: dict[str, Any], with_fields: bool) -> str:
    """The same for people."""
    blocks = [_block(name, look) for name, look in found["looks"].items()]
    if with_fields:
        lines = [
            f"  {name:12} {about['meaning']} ({about['unit']})"
            for name, about in found["fields"].items()
        ]
        blocks.append("\n".join(["Fields, what a pixel's ray meets:", *lines]))
    return "\n\n".join(blocks)


def _block(name: str, look: dict[str, Any]) -> str:
    lines = [f"{name}: {look['light']}"]
    rows = [_row(key, about) for key, about in look["parameters"].items()]
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        lines.append("  " + "  ".join([*cells, row[4]]).rstrip())
    needs = ", ".join(look["needs"])
    dims = "; dims what lies behind" if look["dims_what_lies_behind"] else ""
    terms = [
        line
        for term, about in look["terms"].items()
        for line in (
            f"  +{term}{_with(about['needs'])}: {about['meaning']}",
            *(
                "    " + "  ".join(cell for cell in _row(key, more) if cell)
                for key, more in about["parameters"].items()
            ),
        )
    ]
    return "\n".join([*lines, f"  needs {needs}{dims}", *terms])


def _row(name: str, about: dict[str, Any]) -> list[str]:
    """Name, default, unit, range, meaning with its source."""
    shape = {"number": "", "rgb": "rgb", "either": "1 or rgb"}.get(
        about["shape"], f"{about['shape']} numbers"
    )
    default = about["default"]
    values = default if isinstance(default, list) else [default]
    low, high = (
        "−∞" if bound is None and k == 0 else "∞" if bound is None else number(bound)
        for k, bound in enumerate((about["lower"], about["upper"]))
    )
    source = f" ({about['source']})" if about["source"] else ""
    return [
        name,
        " ".join(number(value) for value in values) + (f", {shape}" if shape else ""),
        "" if about["unit"] == "1" else about["unit"].replace("_", " "),
        f"{low} … {high}",
        about["meaning"] + source,
    ]
