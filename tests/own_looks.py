"""Looks that several test files share, each with what another has not."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from model_jax import (
    Fields,
    Layers,
    Look,
    composite,
    parameter,
)

AIR = "vec3 air(Fields fields, inout float alpha, inout vec3 transmittance)"


class Glow(Look):
    """Air that shines by its width, lit or not."""

    gain: float = parameter("light per width", unit="1/width_unit", default=2.0, lower=0.0)
    NEEDS = ("width",)
    LINEAR_IN = ("width",)
    ROUNDINGS = (2.0, 0.0)
    GLSL = f"uniform float gain;\n{AIR} {{ return gain * fields.color * fields.width; }}"

    def air(self, fields: Fields) -> tuple[jax.Array, None]:
        return self.gain * fields.color * fields.width, None


class Steps(Look):
    """Light by a table over the width."""

    table: Any = parameter("light at widths of 0, ¼, ½ …", default=(0.0, 0.4, 0.6, 0.7), shape=4)
    NEEDS = ("width",)
    ROUNDINGS = (8.0, 4.0)
    GLSL = f"""
        uniform float table[4];
        {AIR} {{
            float at = clamp(fields.width * 12.0, 0.0, 3.0);
            int k = min(int(at), 2);
            return fields.color * (table[k] + (at - float(k)) * (table[k + 1] - table[k]));
        }}"""

    def air(self, fields: Fields) -> tuple[jax.Array, None]:
        at = jnp.clip(fields.width * 12.0, 0.0, 3.0)
        k = jnp.minimum(at.astype(np.int32), 2)
        low, high = self.table[k], self.table[k + 1]
        return fields.color * (low + (at - k) * (high - low)).astype(fields.width.dtype), None


class Veil(Look):
    """A coat with an alpha of its own, and less before the planet."""

    cover: float = parameter("alpha of one width", unit="1/width_unit", default=1.5, lower=0.0)
    ground: float = parameter(
        "share that is left before the planet", default=0.5, lower=0.0, upper=1.0
    )
    NEEDS = ("lit", "dark", "planet")
    ROUNDINGS = (16.0, 8.0)
    BLEND = "over"
    GLSL = f"""
        uniform float cover;
        uniform float ground;
        {AIR} {{
            float share = 1.0 - fields.planet * (1.0 - ground);
            alpha = 1.0 - exp(-cover * (fields.lit + fields.dark) * share);
            return fields.color * (fields.lit / (fields.lit + fields.dark + 0.01));
        }}"""

    def air(self, fields: Fields) -> tuple[jax.Array, None]:
        share = 1.0 - fields.planet * (1.0 - self.ground)
        alpha = 1 - jnp.exp(-self.cover * (fields.lit + fields.dark) * share)
        light = fields.color * (fields.lit / (fields.lit + fields.dark + 0.01))
        return jnp.concatenate([light, alpha], axis=-1), None


def noisy(layers: Layers, look: Look, seed: int = 0) -> np.ndarray:
    light = np.asarray(composite(layers, look))[..., :3]
    return light + np.random.default_rng(seed).normal(scale=0.003, size=light.shape)
