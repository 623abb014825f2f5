"""How layers are coloured: the look's parameters, what each means and its limits.

`Look` owns the defaults of the combine contract (3.0 and 0.2, from the paper's pixel shader); the
shader gets them as uniforms and holds no copy. `PARAMETERS` says of each what a fit, a report and a
command line need to know.
"""

import equinox as eqx
import jax
import numpy as np

from ._errors import InputError, shown
from ._parameter import PARAMETERS
from ._shapes import Scalar, Three, converter


class Look(eqx.Module):
    """Parameters of the combine; a pytree, so that losses can be differentiated by it."""

    brightness: Scalar = eqx.field(
        converter=converter("look.brightness"), default=PARAMETERS["brightness"].default
    )
    """Light per width unit of lit air, multiplying the scene's colour; ≥ 0."""
    shadow: Scalar | Three = eqx.field(
        converter=converter("look.shadow"), default=PARAMETERS["shadow"].default
    )
    """Light of shadowed air as a share of lit air, one number or one per channel; ≥ 0."""
    tint: Three = eqx.field(converter=converter("look.tint"), default=(1.0, 1.0, 1.0))
    """Factor per channel on the scene's colour. A fit keeps its mean at 1, so that brightness and
    tint are separate numbers; the combine takes it as it is."""
    background: Scalar | Three = eqx.field(
        converter=converter("look.background"), default=PARAMETERS["background"].default
    )
    """Light added to every pixel (sky glow, black level), one number or one per channel."""

    def __check_init__(self) -> None:
        shapes: dict[str, list[tuple[int, ...]]] = {"brightness": [()], "tint": [(3,)]}
        for name, info in PARAMETERS.items():
            value = getattr(self, name)
            allowed = shapes.get(name, [(), (3,)])
            if np.shape(value) not in allowed:
                forms = " or ".join("three numbers" if shape else "one number" for shape in allowed)
                raise InputError(f"look.{name}: {shown(value)} must be {forms}")
            if isinstance(value, jax.core.Tracer):
                continue
            if not np.all(np.isfinite(value)):
                raise InputError(f"look.{name}: {shown(value)} must be finite")
            if np.any(np.asarray(value) < info.lower):
                raise InputError(f"look.{name}: {shown(value)} must be at least {info.lower:g}")
