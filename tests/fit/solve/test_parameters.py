"""Parameter records: what they tell, priors, ties, bounds, bad starts; verdicts of made-up ends."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from fit import fit
from fit._judge import _verdict
from fit.solve._declare import declare
from fit.solve._polish import is_settled
from model_jax import InputError, Layers, LayersLook, Response

NOISE = 0.02
TINT = (0.8, 0.9, 1.3)


@pytest.fixture(scope="module")
def widths() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    return rng.uniform(0.1, 0.6, (24, 32)), rng.uniform(0.0, 0.4, (24, 32))


@pytest.fixture(scope="module")
def layers(widths: tuple[np.ndarray, np.ndarray]) -> Layers:
    lit, dark = widths
    return Layers(np.zeros_like(lit), lit + dark, lit, lit + dark, planet=np.zeros_like(lit))


@pytest.fixture(scope="module")
def photo(widths: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    lit, dark = widths
    noise = np.random.default_rng(12).normal(scale=NOISE, size=(*lit.shape, 3))
    return 3.0 * np.array(TINT) * (lit + 0.2 * dark)[..., None] + 0.01 + noise


LOOK = LayersLook(3.0, 0.2, TINT, background=0.01)


EACH = LayersLook(3.0, (0.1, 0.2, 0.3), TINT, background=(0.0, 0.01, 0.02))
UNITS = {
    "brightness": "1/width_unit",
    "shadow": "1",
    "tint": "1",
    "background": "linear light",
    "exposure": "1",
    "gamma": "1",
    "black_level": "recorded light",
}


@pytest.mark.parametrize("look", [LOOK, EACH], ids=["one number", "per channel"])
@pytest.mark.parametrize("photos", [1, 2])
def test_records_say_what_a_parameter_is(look: LayersLook, photos: int) -> None:
    """For every field of a look and of a response: unit, range, typical size and meaning."""
    records = declare(look, [Response()] * photos)
    own = [field.name for field in fields(Response) if field.name != "blur"]
    families = [*LayersLook.PARAMETERS, *own]
    assert list(dict.fromkeys(p.family for p in records)) == families == list(UNITS)
    for p in records:
        assert p.unit == UNITS[p.family]
        assert p.lower < p.value < p.upper or p.value == p.lower == 0
        assert 0 < p.scale < np.inf
        assert len(p.meaning.split()) > 2
    assert len({p.meaning for p in records}) == len(families)
    # A level is small beside the light of the air, whose numbers are of order one.
    assert {p.family for p in records if p.scale < 1} == {"background", "black_level"}


def test_estimates_say_what_their_records_do(layers: Layers, photo: np.ndarray) -> None:
    bounds = {"shadow": (0.05, 2.0)}
    result = fit(photo, layers, LOOK, bounds=bounds)
    rows = result.to_dict()["parameters"]
    records = declare(LOOK, [Response()], bounds=bounds)
    assert list(rows) == list(result.parameters) == [p.name for p in records]
    for p in records:
        estimate, row = result.parameters[p.name], rows[p.name]
        assert (estimate.unit, estimate.meaning, estimate.scale) == (p.unit, p.meaning, p.scale)
        assert estimate.bounds == (p.lower, p.upper)
        assert (row["unit"], row["meaning"], row["scale"]) == (p.unit, p.meaning, p.scale)
        assert row["bounds"] == [x if np.isfinite(x) else None for x in (p.lower, p.upper)]
    assert rows["shadow"]["bounds"] == [0.05, 2.0]


def test_a_prior_is_the_conjugate_formula(
    layers: Layers, photo: np.ndarray, widths: tuple[np.ndarray, np.ndarray]
) -> None:
    """Normal prior on brightness, linear model: posterior mean and width are known in closed form.

    The noise in the formula is the fit's own, known to sqrt(1/2n) = 1.5 %; the sandwich over blocks
    of the photo's share of the width is uncertain by a few ten percent.
    """
    row = (np.array(TINT) * (widths[0] + 0.2 * widths[1])[..., None]).reshape(-1)
    y, mean, sigma = photo.reshape(-1) - 0.01, 2.998, NOISE / np.sqrt(row @ row)
    result = fit(
        photo, layers, LOOK, free=("brightness",), priors={"brightness": (mean, float(sigma))}
    )
    noise = result.errors.noise if result.errors is not None else np.nan
    precision = row @ row / noise**2 + 1 / sigma**2
    best = (row @ y / noise**2 + mean / sigma**2) / precision
    assert result.verdict == "converged"
    assert result.parameters["brightness"].prior == (mean, sigma)
    # Halfway between the two, to the 1 % in the noise to which rounds are made.
    assert abs(best - mean) > sigma / 2
    assert result.look.brightness == pytest.approx(best, abs=float(0.02 * abs(best - mean)))
    assert result.parameters["brightness"].stderr == pytest.approx(precision**-0.5, rel=0.3)


def test_bounds_that_bind_are_scipys(
    layers: Layers, photo: np.ndarray, widths: tuple[np.ndarray, np.ndarray]
) -> None:
    """Brightness and background bounded, both linear: against SciPy's bounded linear solver."""
    row = (np.array(TINT) * (widths[0] + 0.2 * widths[1])[..., None]).reshape(-1)
    matrix = np.stack([row, np.ones_like(row)], axis=1)
    free, bounds = ("brightness", "background"), {"brightness": (0.0, 2.8)}
    exact = lsq_linear(matrix, photo.reshape(-1), bounds=([0, -np.inf], [2.8, np.inf]), tol=1e-14)
    result = fit(photo, layers, LOOK, free=free, bounds=bounds)
    assert result.verdict == "at_bound"
    assert result.parameters["brightness"].value == 2.8
    assert result.parameters["brightness"].role == "at_bound"
    assert result.look.background == pytest.approx(exact.x[1], rel=1e-6)
    # Held against the bound: less brightness would be worse, more is not allowed (KKT).
    gradient = matrix.T @ (matrix @ [2.8, float(result.look.background)] - photo.reshape(-1))
    assert gradient[0] < 0
    assert abs(gradient[1]) <= 1e-6 * np.abs(gradient[0])


@pytest.mark.parametrize("gap", [1e-6, 1e-4, 1e-2], ids=str)
def test_just_inside_is_not_at_bound(gap: float, layers: Layers, photo: np.ndarray) -> None:
    """An optimum a hair inside its bound is found there, with its error."""
    plain = fit(photo, layers, LOOK, free=("brightness", "background"))
    best = float(plain.look.brightness)
    bounds = {"brightness": (0.0, best * (1 + gap))}
    result = fit(photo, layers, LOOK, free=("brightness", "background"), bounds=bounds)
    assert plain.verdict == "converged"
    error = plain.parameters["brightness"].stderr
    assert error is not None
    # Within a thousandth of a standard error the two cannot be told apart, nor need they.
    if gap * best > 1e-3 * error:
        assert result.verdict == "converged"
        assert result.look.brightness == pytest.approx(best, rel=1e-9)
    assert abs(float(result.look.brightness) - best) <= 1e-3 * error


@pytest.mark.parametrize("start", [0.0, 2.0, 5.0], ids=["lower", "upper", "beyond"])
def test_starts_on_a_bound(start: float, layers: Layers, photo: np.ndarray) -> None:
    look = LayersLook(3.0, start, TINT, background=0.01)
    bounds = {"shadow": (0.0, 2.0)}
    result = fit(photo, layers, look, free=("brightness", "shadow"), bounds=bounds)
    assert result.verdict == "converged"
    shadow = result.parameters["shadow"]
    assert shadow.stderr is not None
    assert abs(shadow.value - 0.2) < 4 * shadow.stderr < 0.02


def test_ties(layers: Layers, photo: np.ndarray) -> None:
    """Two tints as one; two photos' gammas through a chain; errors are those of the one."""
    free = ("brightness", "tint")
    tinted = fit(photo, layers, LOOK, free=free, tied={"tint.g": "tint.r"})
    r, g, b = (tinted.parameters[f"tint.{k}"] for k in "rgb")
    assert tinted.verdict == "converged"
    assert g.role == "tied"
    assert g.tied_to == "tint.r"
    assert (r.value, r.stderr) == (pytest.approx(g.value, rel=1e-12), pytest.approx(g.stderr))
    assert (r.value + g.value + b.value) / 3 == pytest.approx(1.0, abs=1e-12)
    many = [photo, photo, photo]
    chain = {"exposure.3": "exposure.2", "exposure.2": "exposure.1"}
    look = LayersLook(1.0, 0.2, TINT, background=0.01)
    shared = fit(many, [layers] * 3, look, free=("exposure.1",), tied=chain)
    values = [shared.parameters[f"exposure.{k}"] for k in (1, 2, 3)]
    assert shared.verdict == "converged"
    assert [v.tied_to for v in values] == [None, "exposure.1", "exposure.1"]
    assert values[0].value == pytest.approx(3.0, rel=0.02)
    assert values[0].value == values[1].value == values[2].value


BAD = {
    "unknown free": ({"free": ("haze",)}, r"'haze' is no parameter; choose"),
    "unknown bound": ({"bounds": {"haze": (0.0, 1.0)}}, r"bounds: 'haze'.*choose"),
    "unknown prior": ({"priors": {"haze": (0.0, 1.0)}}, r"prior: 'haze'.*choose"),
    "unknown tie": ({"tied": {"haze": "shadow"}}, r"tied: 'haze'.*choose"),
    "unlike tie": ({"tied": {"shadow": "brightness"}}, r"shadow and brightness are different"),
    "self tie": ({"tied": {"tint.r": "tint.r"}}, r"tint.r → tint.r is a circle; leave"),
    "circle": (
        {"tied": {"tint.r": "tint.g", "tint.g": "tint.b", "tint.b": "tint.r"}},
        r"circle; leave one",
    ),
    "crossed bounds": (
        {"bounds": {"shadow": (0.5, 0.1)}},
        r"shadow from 0.5 to 0.1 .*give a lower",
    ),
    "equal bounds": ({"bounds": {"shadow": (0.5, 0.5)}}, r"shadow from 0.5 to 0.5 .*give a lower"),
    "outside range": (
        {"bounds": {"shadow": (-2.0, -1.0)}},
        r"shadow from -2 to -1 .*inside the range",
    ),
    "nan bound": ({"bounds": {"shadow": (float("nan"), 1.0)}}, r"shadow from nan to 1 .*give"),
    "held outside": (
        {"free": ("brightness",), "bounds": {"shadow": (0.5, 1.0)}},
        r"shadow is held at 0.2, outside 0.5 to 1; free it",
    ),
    "zero width": ({"priors": {"shadow": (0.2, 0.0)}}, r"shadow has the width 0.0; give"),
    "negative width": ({"priors": {"shadow": (0.2, -1.0)}}, r"shadow has the width -1.0; give"),
    "nan width": ({"priors": {"shadow": (0.2, float("nan"))}}, r"shadow has the width nan; give"),
    "nan mean": ({"priors": {"shadow": (float("nan"), 1.0)}}, r"shadow has the mean nan; give"),
    "prior on a tied one": (
        {"tied": {"tint.g": "tint.r"}, "priors": {"tint.g": (1.0, 0.1)}},
        r"tint.g has a prior of its own; give it to tint.r",
    ),
    "nothing free": ({"free": ()}, r"nothing to fit; choose"),
    "solver": ({"solver": "newton"}, r"'newton' is unknown; choose"),
    "loss": ({"loss": "l1"}, r"'l1' is unknown; choose"),
}


@pytest.mark.parametrize(("options", "pattern"), BAD.values(), ids=BAD)
def test_bad_requests(
    options: dict[str, Any], pattern: str, layers: Layers, photo: np.ndarray
) -> None:
    """One line: the thing, its value, what to do."""
    with pytest.raises(InputError, match=pattern) as caught:
        fit(photo, layers, LOOK, **options)
    assert "\n" not in str(caught.value)


def test_starts_that_are_no_numbers() -> None:
    with pytest.raises(InputError, match=r"look.brightness: .*nan.* must be finite"):
        LayersLook(float("nan"))
    with pytest.raises(InputError, match=r"look.tint: .* must be finite"):
        LayersLook(1.0, 0.2, (1.0, np.nan, 1.0))
    with pytest.raises(InputError, match=r"response.gamma: .*nan.* must be a finite number"):
        Response(1.0, float("nan"))


def test_verdicts_of_bad_ends(layers: Layers, photo: np.ndarray) -> None:
    """The judgement itself, on made-up ends."""
    result = fit(photo, layers, LOOK, free=("brightness", "background"))
    task, end, problem = (getattr(result.evidence, n) for n in ("task", "end", "problem"))
    assert _verdict(task, end, result.photos).label == "converged"
    assert _verdict(task, replace(end, finite=False), result.photos).label == "diverged"
    assert _verdict(task, replace(end, settled=False), result.photos).label == "not_converged"
    bound = replace(end, at_bound=end.free[:1])
    assert _verdict(task, bound, result.photos).label == "at_bound"
    assert _verdict(task, replace(bound, settled=False), result.photos).label == "not_converged"
    photo_result = result.photos[0]
    for poor in (replace(photo_result, explained=0.4), replace(photo_result, structure=0.5)):
        bad = [poor]
        assert _verdict(task, bound, bad).label == "misfit"
        assert _verdict(task, replace(end, settled=False), bad).label == "not_converged"
    assert not is_settled(problem, np.full_like(end.gram, np.nan))
