"""The look `layers`: the combine step of the paper, air that shines by its width."""

from typing import Any

from .._fields import Fields
from .._look import Look, Separable, parameter
from .._shapes import Scalar, Three

_PAPER = "the paper's pixel shader"


class LayersLook(Look):
    """Air as a uniform slab: `brightness · color · tint · (lit + shadow · dark)`."""

    brightness: Scalar = parameter(
        "light per width unit of lit air, times colour",
        unit="1/width_unit",
        lower=0.0,
        default=3.0,
        source=_PAPER,
    )
    """Light per width unit of lit air, multiplying the scene's colour; ≥ 0."""
    shadow: Scalar | Three = parameter(
        "light of shadowed air as a share of lit air",
        lower=0.0,
        default=0.2,
        shape="either",
        of="dark",
        source=_PAPER,
    )
    """Light of shadowed air as a share of lit air, one number or one per channel; ≥ 0."""
    tint: Three = parameter(
        "factor on the air's colour, mean 1 over the channels",
        lower=0.0,
        upper=3.0,
        default=(1.0, 1.0, 1.0),
        shape="rgb",
        mean_one=True,
    )
    """Factor per channel on the scene's colour. A fit keeps its mean at 1, so that brightness and
    tint are separate numbers; the combine takes it as it is."""

    NEEDS = ("lit", "dark")
    LINEAR_IN = ("lit", "dark")
    # ½ ulp on either side for the sum and each product, by shadow, tint, colour and brightness, of
    # the light, which bounds all that is added up.
    ROUNDINGS = (5.0, 0.0)
    SEPARABLE = Separable("brightness", "tint", "shadow", "lit", "dark")

    def air(self, fields: Fields) -> tuple[Any, Any]:
        width = fields.lit + self.shadow * fields.dark
        return self.brightness * (fields.color * self.tint * width), None
