"""The words that options of `fit` take, and the checks of them; without JAX, for command lines."""

from typing import Literal, TypeVar, get_args

from model_jax._errors import InputError, shown
from render_gl._choices import Source

LayerSource = Literal[Source, "analytic"]
"""Where a scene's layers come from: OpenGL's two ways, or exact intersection in JAX."""

CHANNELS = ("r", "g", "b")
"""Endings of a colour's parts, as in NAME.r."""

AUTO = "auto"
"""In place of a look's name: its terms are chosen by the photos."""

LossName = Literal["linear", "huber", "soft_l1", "cauchy"]
LOSSES: tuple[LossName, ...] = get_args(LossName)
"""As in SciPy's `least_squares`; "linear" is plain least squares."""

SolverName = Literal["lm", "dogleg", "bfgs"]
SOLVERS: tuple[SolverName, ...] = get_args(SolverName)
"""optimistix's Levenberg–Marquardt, dogleg and BFGS."""

JpegHandling = Literal["keep", "undo"]
"""What is done about a photo that is a JPEG: nothing but a warning, or what
`diagnose._compression` does."""
_HANDLINGS: tuple[JpegHandling, ...] = get_args(JpegHandling)

Sampling = Literal["area", "point"]
"""What a pixel of a photo shows: a mean over its square, or a part of it, as a camera's or of a
supersampled picture; or the light in its middle, as of a render without antialiasing."""
_SAMPLINGS: tuple[Sampling, ...] = get_args(Sampling)

Where = Literal["all", "ring", "sky", "planet"]
"""Which air is looked at: in front of space and, where the layers bring a surface, of the planet;
or of one of them only; or in front of space, and space beside it."""
_WHERE: tuple[Where, ...] = get_args(Where)

MOST_STEPS = 1_000_000
"""Most that may be asked for; each keeps a number of the descent, 8 MB in all."""

_Name = TypeVar("_Name", bound=str)


def one_of(what: str, name: object, known: tuple[_Name, ...]) -> _Name:
    """The name, if it is one of those that are known; else an `InputError`."""
    for one in known:
        if name == one:
            return one
    raise InputError(f"{what}: {shown(name)} is unknown; choose from {list(known)}")


def check_loss(name: object) -> LossName:
    """The name, if it is one of `LOSSES`; else an `InputError`."""
    return one_of("loss", name, LOSSES)


def check_solver(name: object) -> SolverName:
    """The name, if it is one of `SOLVERS`; else an `InputError`."""
    return one_of("solver", name, SOLVERS)


def check_jpeg(name: object) -> JpegHandling:
    """The name, if it is a `JpegHandling`; else an `InputError`."""
    return one_of("jpeg", name, _HANDLINGS)


def check_sampling(name: object) -> Sampling:
    """The name, if it is a `Sampling`; else an `InputError`."""
    return one_of("sampling", name, _SAMPLINGS)


def check_where(name: object) -> Where:
    """The name, if it is a `Where`; else an `InputError`."""
    return one_of("where", name, _WHERE)


def check_steps(name: str, steps: object) -> None:
    """Raise `InputError` for a number of steps that no descent takes; None is the solver's own."""
    if steps is not None and not (isinstance(steps, int) and 1 <= steps <= MOST_STEPS):
        raise InputError(
            f"{name}: is {shown(steps)}; give a whole number, 1 to {MOST_STEPS:,}, or none"
        )
