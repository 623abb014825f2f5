"""A fit.json document of each verdict."""

from typing import Any

from model_jax import LayersLook
from model_jax._look import look_record


def row(value: float, stderr: float | None = None, **changes: Any) -> dict[str, Any]:
    """A parameter of the document; free when it has an error."""
    reach = None if stderr is None else 1.96 * stderr
    return {
        "value": value,
        "stderr": stderr,
        "interval": None if reach is None else [value - reach, value + reach],
        "initial": value,
        "free": stderr is not None,
        "role": "fixed" if stderr is None else "free",
        "unit": "1",
        "bounds": [0.0, None],
        "scale": 1.0,
        "prior": None,
        "tied_to": None,
        "quantisation_bound": None,
        "layer_error": None,
        "compression_shift": None,
        "meaning": "",
    } | changes


def held_response(number: str = "") -> dict[str, dict[str, Any]]:
    """A response that changes nothing: no line is spent on it."""
    return {
        f"exposure{number}": row(1.0),
        f"gamma{number}": row(1.0),
        f"black_level{number}": row(0.0, unit="recorded light"),
    }


LOOK = {
    "brightness": row(3.0123, 0.0034, unit="1/width_unit", initial=1.0, quantisation_bound=0.012),
    "shadow": row(0.2011, 0.0012, initial=0.5, quantisation_bound=0.0031),
    "tint.r": row(0.9032, 0.0009, initial=1.0, quantisation_bound=0.0052),
    "tint.g": row(1.0001, 0.0006, initial=1.0, quantisation_bound=0.0048),
    "tint.b": row(1.0967, 0.0011, initial=1.0, quantisation_bound=0.0061),
    "background": row(0.00213, 0.00041, unit="linear light", initial=0.0, bounds=[None, None]),
}
PIXELS = {"used": 12345, "total": 172800, "excluded": {"no air": 160455}, "clipped_samples": 0}
ERRORS = {
    "noise": 0.00412,
    "correlation_px": 1.0,
    "block_px": 8,
    "blocks": 856,
    "effective_samples": 37035.0,
}


def photo_row(**changes: Any) -> dict[str, Any]:
    """What the document says of one photo."""
    row = {
        "pixels": PIXELS,
        "residual_rms": 0.00418,
        "explained": 0.9981,
        "structure": 0.01,
        "width_unit": 5.5,
        "alignment": None,
    }
    return row | changes


def document(**changes: Any) -> dict[str, Any]:
    """A document as a fit makes it; the command line adds to it what else it knows."""
    return {
        "verdict": "converged",
        "message": "The fit converged; it explains 99.81 % of the light's variance in the pixels "
        "used.",
        "warnings": [],
        "selection": None,
        "parameters": LOOK | held_response(),
        "correlation": {
            "names": ["brightness", "shadow"],
            "matrix": [[1.0, -0.31], [-0.31, 1.0]],
        },
        "errors": ERRORS,
        "residual_rms": 0.00418,
        "explained": 0.9981,
        "structure": 0.01,
        "look": look_record(LayersLook()),
        "per_length": {"brightness": 0.5477},
        "width_unit": 5.5,
        "pixels": PIXELS,
        "photos": [photo_row()],
        "left_out": [],
        "misfits": [],
        "solver": "lm",
        "loss": "linear",
        "history": [41.2, 3.2, 0.91, 0.65],
        "second_opinion": "closed form",
        "seconds": {"render": 0.25, "reduce": 0.04, "solve": 0.5, "errors": 0.12},
    } | changes


NOTHING: dict[str, Any] = {
    "errors": None,
    "correlation": {"names": [], "matrix": []},
    "residual_rms": None,
    "explained": None,
    "structure": None,
    "history": [],
    "photos": [photo_row(residual_rms=None, explained=None)],
}
MASKED = {"used": 0, "total": 172800, "excluded": {"masked": 172800}, "clipped_samples": 0}

CASES: dict[str, dict[str, Any]] = {
    "converged": document(photos=[photo_row(tone_curve="srgb")]),
    "warned": document(
        message="The fit converged; it explains 54.58 % of the light's variance in the pixels "
        "used. The background came out negative: the model takes light away.",
        warnings=["The background came out negative: the model takes light away."],
        explained=0.5458,
        parameters=LOOK | {"background": row(-0.155, 0.046, unit="linear light", initial=0.0)},
        correlation={
            "names": ["brightness", "background"],
            "matrix": [[1.0, -0.974], [-0.974, 1.0]],
        },
        errors=ERRORS | {"correlation_px": 64.0, "block_px": 64, "effective_samples": 22.4},
        pixels=PIXELS | {"clipped_samples": 1042},
        photos=[photo_row(pixels=PIXELS | {"clipped_samples": 1042}, explained=0.5458)],
    ),
    "at_bound": document(
        verdict="at_bound",
        message="The best fit lies at a bound (shadow); it explains 97.2 % of the light's variance "
        "in the pixels used. To do: check the alignment of photo and layers, the tone curve and "
        "the background, and mask what is no air.",
        parameters=LOOK | {"shadow": row(0.0, role="at_bound", free=True, initial=0.5)},
    ),
    "not_identifiable": document(
        verdict="not_identifiable",
        message="The photo cannot tell all that was asked; left out: exposure. To do: hold what is "
        "named in left_out, or use a photo that shows it.",
        parameters=LOOK | held_response() | {"exposure": row(1.0, role="held")},
        left_out=[
            {
                "what": "exposure",
                "why": "the photo tells brightness and exposure only as a product; fix one or add "
                "a photo of another exposure that is known; held at its start value",
            }
        ],
    ),
    "not_converged": document(
        verdict="not_converged",
        message="The solver stopped before the best fit. To do: use solver 'lm' or allow more "
        "steps.",
        solver="bfgs",
        history=[41.2, 40.9],
        second_opinion="lower",
    ),
    "diverged": document(
        verdict="diverged",
        message="The solver ran off to infinity. To do: use solver 'lm' and check the photo's "
        "values.",
        parameters={
            name: row(e["initial"], unit=e["unit"], role="held") for name, e in LOOK.items()
        },
        solver="dogleg",
        **NOTHING,
    ),
    "no_data": document(
        verdict="no_data",
        message="There is nothing to fit: no pixel can be used (172800 masked). To do: check the "
        "mask, the alignment of photo and layers, and the exposure.",
        parameters={name: row(e["initial"], unit=e["unit"]) for name, e in LOOK.items()},
        pixels=MASKED,
        seconds={},
        **NOTHING | {"photos": [photo_row(pixels=MASKED, residual_rms=None, explained=None)]},
    ),
    "several_photos": document(
        parameters=LOOK
        | held_response(".1")
        | {
            "black_level.1": row(0.00999, 0.00004, unit="recorded light", initial=0.0),
            "exposure.2": row(0.599972, 0.000085, prior=[0.6, 0.02]),
            "gamma.2": row(1.0, tied_to="gamma.1", role="tied"),
            "black_level.2": row(0.020047, 0.000035, unit="recorded light", initial=0.0),
        },
        photos=[
            photo_row(explained=0.9995, tone_curve="srgb"),
            photo_row(
                pixels=PIXELS | {"used": 21004, "clipped_samples": 39},
                residual_rms=0.00414,
                tone_curve={"exposure": 1.5, "gamma": 2.2},
            ),
        ],
        second_opinion="same",
    ),
    "jpeg": document(
        parameters=LOOK
        | {
            "brightness": row(2.9875, 0.0051, unit="1/width_unit", compression_shift=-0.0231),
            "shadow": row(0.2011, 0.0012, compression_shift=0.00017),
        },
    ),
    "robust": document(
        loss="cauchy",
        parameters=LOOK
        | {
            "brightness": row(
                2.99983, 0.00041, unit="1/width_unit", prior=[3.0, 0.5], bounds=[0.0, 5.0]
            )
        },
        errors=ERRORS | {"correlation_px": 42.0, "block_px": 80, "blocks": 20},
        second_opinion="same",
    ),
}
