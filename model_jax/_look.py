"""What a look is: parameters, the fields it asks for, and the light it makes of them.

    class Haze(Look):
        depth: float = parameter("optical depth of one width", default=1.0, lower=0.0)
        NEEDS = ("width",)
        ROUNDINGS = (4.0, 6.0)

        def air(self, fields):
            return 1 - jnp.exp(-self.depth * fields.color * fields.width), None

Scene keys, uniforms, defaults, names on the command line, bounds, the fit's vector, report rows and
exports are computed from these (`docs/add-a-look.md`).
"""

import dataclasses
import inspect
import math
import re
from abc import abstractmethod
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Float

from ._errors import InputError, shown
from ._fields import Fields
from ._parameter import RESPONSE_PARAMETERS, Parameter, Shape, Smooth
from ._shapes import Scalar, Three, converter

Blend = Literal["add", "over", "premultiplied"]
"""How light and its alpha lie over the surface: `surface + light`, `surface (1 - alpha) + light
alpha` (the traditional blend), or `surface (1 - alpha) + light`."""

_ABOUT = "airlight"  # where a dataclass field keeps its `Parameter`

L = TypeVar("L", bound="Look")


class _Convert:
    """A field's converter, which learns its name once its class exists."""

    def __init__(self, name: str = "look") -> None:
        self.name = name

    def __call__(self, value: object) -> Any:
        return converter(self.name)(value)


def parameter(
    meaning: str,
    *,
    default: float | tuple[float, ...],
    unit: str = "1",
    lower: float = -math.inf,
    upper: float = math.inf,
    scale: float = 1.0,
    shape: Shape = "number",
    mean_one: bool = False,
    of: str | None = None,
    source: str = "",
    smooth: Smooth | None = None,
) -> Any:
    """A parameter of a look, as the value of an annotated field of its class.

    Args:
        meaning: for reports, without a full stop.
        default: a number, or as many as the shape says; within the range.
        unit, lower, upper, scale, shape, mean_one, of, source, smooth: as `Parameter` says.
    """
    about = Parameter(
        meaning, unit, lower, upper, default, scale, shape, mean_one, of, source, smooth=smooth
    )
    return eqx.field(default=default, converter=_Convert(), metadata={_ABOUT: about})


_BACKGROUND = Parameter(
    "light added to every pixel",
    "linear light",
    -math.inf,
    math.inf,
    0.0,
    scale=0.01,
    shape="either",
    least=0.0,
)


@dataclasses.dataclass(frozen=True)
class Separable:
    """A fact that spares a fit its search: with gamma 1 the light of a channel is

        amplitude · color · factors · (first + weight · second)

    so that given the weight all else is a linear least squares problem (`fit.solve._separable`).
    """

    amplitude: str
    """A parameter, one number."""
    factors: str
    """A parameter with a mean of one, three numbers."""
    weight: str
    """A parameter, one number or three."""
    first: str
    second: str
    """Fields; the second may be absent."""


class Look(eqx.Module):
    """Parameters of how air is coloured; a pytree, so that losses can be differentiated by it.

    A look is a subclass with a field for each parameter (`parameter`), the facts below, and `air`.
    """

    NAME: ClassVar[str] = ""
    """As in scene files and on command lines; of the class's name unless given."""
    PARAMETERS: ClassVar[dict[str, Parameter]] = {"background": _BACKGROUND}
    """Every parameter by its field name, in the order reports show them; made from the fields."""
    NEEDS: ClassVar[tuple[str, ...]] = ()
    """Fields that `air` asks for, names of `FIELDS`: passes and read-backs follow from them."""
    LINEAR_IN: ClassVar[tuple[str, ...]] = ()
    """Fields in which the light is linear, all others held; sums over pixels can then stand for
    them, if these are all that it needs and it has no transmittance."""
    ROUNDINGS: ClassVar[tuple[float, float]] = (0.0, 0.0)
    """Rounding errors that both sides' arithmetic between fields and light can make, in ulp of the
    light itself, and in ulp of 1, where a formula subtracts from 1; of the transmittance likewise.
    For the bound of the cross-check."""
    BLEND: ClassVar[Blend] = "add"
    """What is done with the light's alpha, if `air` returns one."""
    SEPARABLE: ClassVar[Separable | None] = None
    AMPLITUDE: ClassVar[tuple[str, ...]] = ()
    """Parameters to whose product the light is proportional, channel by channel, all others held:
    a number, and perhaps factors with a mean of one. A fit then solves for them, and its starts
    differ in the others only."""
    GROUND: ClassVar[str] = ""
    """Parameter, a colour ≥ 0, that light of what lies behind the air is multiplied by before the
    air dims it; not the shader's business. Empty: nothing is."""
    LIGHTS_GROUND: ClassVar[bool] = False
    """It lights the ground itself, by its transmittance: what lies behind the air is the ground's
    albedo then, not Lambert's light on it."""
    TERMS: ClassVar[dict[str, str]] = {}
    """What may be added to it (`with_terms`), by name, and what that does."""
    TERM_NEEDS: ClassVar[dict[str, tuple[str, ...]]] = {}
    """Terms without which one cannot be, by its name."""
    TERM_OFF: ClassVar[dict[str, dict[str, float]]] = {}
    """Values of a term's parameters with which it does nothing, by its name; of a term that can be
    left out only by another program there are none."""
    CHOICES: ClassVar[tuple[str, ...]] = ()
    """Terms that a fit chooses among where nobody names any, those that are cheap first."""
    PICTURE: ClassVar[str] = ""
    """Key of scene files that names a picture which parameters are taken from (`of_picture`)."""
    GLSL: ClassVar[str | None] = None
    """Text of its twin; None: the file NAME.glsl beside the module."""

    background: Scalar | Three = eqx.field(
        default=_BACKGROUND.default, converter=_Convert("look.background"), kw_only=True
    )
    """Light added to every pixel (sky glow, black level), one number or one per channel; the
    frame's, whatever the look."""

    if TYPE_CHECKING:  # which parameters a look has only its class knows

        def __init__(self, **values: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if not cls.__dict__.get("NAME"):
            cls.NAME = cls.__name__.removesuffix("Look").lower() or "look"
        annotated = inspect.get_annotations(cls)
        own = {}
        for name, value in cls.__dict__.items():
            if isinstance(value, dataclasses.Field) and _ABOUT in value.metadata:
                if name not in annotated:
                    raise InputError(
                        f"look {cls.NAME}: {name} has no annotation; write {name}: float = "
                        "parameter(…)"
                    )
                own[name] = _named(cls.NAME, name, value)
        # The nearest class's word counts; what it inherits comes after its own.
        inherited = {name: p for name, p in cls.PARAMETERS.items() if name not in own}
        cls.PARAMETERS = own | inherited

    @classmethod
    def with_terms(cls, terms: Iterable[str]) -> "type[Look]":
        """The look with some of its `TERMS`, named as `air+density`.

        Raises `InputError` naming a term that it does not have.
        """
        for name in terms:
            raise InputError(f"look {cls.NAME}: has no term {shown(name)}; it has none at all")
        return cls

    @classmethod
    def of_picture(cls, picture: Float[np.ndarray, "h w 4"]) -> dict[str, Any]:
        """Values of the parameters that a picture stands for, by name.

        Raises `InputError` for one that cannot.
        """
        raise InputError(f"look {cls.NAME}: is made of no picture")

    @abstractmethod
    def air(self, fields: Fields) -> tuple[Any, Any]:
        """Light of the air, and how much of what lies behind passes it.

        The parameters broadcast with the fields: numbers and colours have the fields' rank and
        dtype here; tables are as they are.

        Args:
            fields: what `NEEDS` names, [..., 1] each, and the air's `color` [..., 3].

        Returns:
            light [..., 3], or [..., 4] with its alpha; transmittance [..., 3] or [..., 1] in
            [0, 1], or None where all passes: then it is not multiplied.
        """

    def __check_init__(self) -> None:
        for name, about in type(self).PARAMETERS.items():
            value = getattr(self, name)
            if np.shape(value) not in about.shapes:
                forms = " or ".join(_form(shape) for shape in about.shapes)
                raise InputError(f"look.{name}: {shown(value)} must be {forms}")
            if isinstance(value, jax.core.Tracer):
                continue
            if not np.all(np.isfinite(value)):
                raise InputError(f"look.{name}: {shown(value)} must be finite")
            if np.any(np.asarray(value) < about.lower):
                raise InputError(f"look.{name}: {shown(value)} must be at least {about.lower:g}")
            # Above its range a factor of mean one is bounded by the others, which a fit knows.
            if not about.mean_one and np.any(np.asarray(value) > about.upper):
                raise InputError(f"look.{name}: {shown(value)} must be at most {about.upper:g}")


def broadcast(look: L, rank: int, dtype: DTypeLike) -> L:
    """The look with arrays of a dtype: numbers and colours multiply fields of a rank."""
    known = type(look).PARAMETERS
    values = []
    for name, about in known.items():
        shape = (-1,) if isinstance(about.shape, int) else (1,) * (rank - 1) + (-1,)
        values.append(jnp.asarray(getattr(look, name), dtype).reshape(shape))
    return eqx.tree_at(lambda part: [getattr(part, name) for name in known], look, values)


def light_of(kind: type[Look]) -> str:
    """What looks of a kind make of the air, in a line: the first of its docstring; and what
    multiplies the light behind it."""
    line = (kind.__doc__ or "").strip().split("\n")[0]
    return f"{line} `{kind.GROUND}` multiplies the light behind it." if kind.GROUND else line


def look_record(look: Look) -> dict[str, Any]:
    """Which look it is, as plain JSON data, and what an export has to know of it."""
    kind = type(look)
    return {
        "kind": kind.NAME,
        "light": light_of(kind),
        "shapes": {name: about.shape for name, about in kind.PARAMETERS.items()},
    }


_TAKEN = {
    *RESPONSE_PARAMETERS,
    # What a look has itself.
    *("background", "air", "NAME", "PARAMETERS", "NEEDS", "LINEAR_IN", "ROUNDINGS", "BLEND"),
    *("SEPARABLE", "AMPLITUDE", "GROUND", "GLSL", "TERMS", "TERM_NEEDS", "TERM_OFF", "CHOICES"),
    *("LIGHTS_GROUND", "PICTURE", "with_terms", "of_picture"),
    # Keys of scene files and exports.
    *("kind", "look", "verdict", "warnings", "color", "width_unit"),
    *("atmosphere_path", "atmosphere_height", "planet_radius"),
    # Words of GLSL that are names in Python.
    *(
        "attribute",
        "bool",
        "buffer",
        "case",
        "cast",
        "centroid",
        "common",
        "const",
        "discard",
        "do",
    ),
    *("do", "double", "enum", "extern", "external", "false", "filter", "fixed", "flat", "float"),
    *(
        "half",
        "highp",
        "inline",
        "input",
        "inout",
        "int",
        "interface",
        "invariant",
        "layout",
        "long",
    ),
    *("long", "lowp", "main", "mediump", "namespace", "noinline", "noperspective", "out", "output"),
    *("partition", "patch", "precise", "precision", "public", "resource", "sample", "shared"),
    *("short", "sizeof", "smooth", "static", "struct", "subroutine", "superp", "switch"),
    *("template", "this", "true", "typedef", "uint", "uniform", "union", "unsigned", "using"),
    *("varying", "void", "volatile"),
}
"""Names that no parameter of a look may have."""


def _named(look: str, name: str, field: Any) -> Parameter:
    """The parameter of a field, once its converter knows its name and it is possible."""
    about: Parameter = field.metadata[_ABOUT]
    field.metadata["converter"].name = f"look.{name}"
    where = f"look {look}: parameter {name}"
    if name in _TAKEN or name.startswith("gl_") or name.endswith("_per_length"):
        raise InputError(f"{where} has a name that is taken; give it another")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", name):
        raise InputError(f"{where} is no identifier of a shader; use letters, digits and single _")
    table = isinstance(about.shape, int) and not isinstance(about.shape, bool)
    if about.shape not in ("number", "rgb", "either") and not (table and 2 <= about.size <= 4096):
        raise InputError(
            f"{where} has the shape {shown(about.shape)}; give 'number', 'rgb', 'either', or 2 to "
            "4096 for a table"
        )
    if np.shape(about.default) not in about.shapes:
        forms = " or ".join(_form(shape) for shape in about.shapes)
        raise InputError(f"{where} has the default {shown(about.default)}; give {forms}")
    if about.smooth is not None:
        reach = {k for pair in about.smooth.neighbours for k in pair}
        if not table or not reach <= set(range(about.size + 1)) or not about.smooth.sigma > 0:
            raise InputError(
                f"{where} is smooth otherwise than a table of {about.size} can be; give pairs of "
                f"0 to {about.size} and a sigma above 0"
            )
    if not about.lower < about.upper:
        raise InputError(f"{where} has no room between {about.lower:g} and {about.upper:g}")
    return about


def _form(shape: tuple[int, ...]) -> str:
    if not shape:
        return "one number"
    return "three numbers" if shape == (3,) else f"{shape[0]} numbers"
