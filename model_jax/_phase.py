"""How light that air scatters is spread over directions: phase functions.

Their average over all directions is 1, but for the cheap one's.

All are functions of the cosine of the angle by which light is turned, 1 where it goes on as it
came: towards a camera that looks at the sun.

Twins in `phase.glsl`.
"""

import jax.numpy as jnp

from ._shapes import AnyArray

NEAREST = 1e-6
"""Least squared distance 1 + g² - 2 g cos, of which a power divides. At |g| ≤ 0.999 none is less;
beyond that the peak is no narrower, so that it and its slopes are numbers."""


def rayleigh(cos: AnyArray) -> AnyArray:
    """Of what is small beside the wavelength: 3/4 (1 + cos²).

    Source: Lord Rayleigh, "On the light from the sky, its polarization and colour", 1871.

    Twin: `rayleigh` in `phase.glsl`.
    """
    return 0.75 * (1 + cos * cos)


def henyey_greenstein(cos: AnyArray, asymmetry: AnyArray) -> AnyArray:
    """Of haze: (1 - g²)/(1 + g² - 2 g cos)^1.5, whose mean cosine is the asymmetry g.

    g above 0 sends light on as it came, below 0 back; at ±1 it is 0 everywhere but there.

    Source: Henyey & Greenstein, "Diffuse radiation in the galaxy", 1941.

    Twin: `henyey_greenstein` in `phase.glsl`.
    """
    size = jnp.abs(asymmetry)
    squared = squared_distance(cos, asymmetry)
    return (1 - size) * (1 + size) / (squared * jnp.sqrt(squared))


def squared_distance(cos: AnyArray, asymmetry: AnyArray) -> AnyArray:
    """1 + g² - 2 g cos as a sum, of which neither part cancels where g and cos are near 1 or -1.

    Twin: `squared_distance` in `phase.glsl`.
    """
    size, turned = jnp.abs(asymmetry), jnp.where(asymmetry < 0, 1 + cos, 1 - cos)
    return jnp.maximum((1 - size) ** 2 + 2 * size * jnp.maximum(turned, 0), NEAREST)


def cheap_cornette_shanks(cos: AnyArray, asymmetry: AnyArray) -> AnyArray:
    """Of haze, without a root: 3/2 (1 - g²)/(2 + g²) (1 + cos²)/(1 + g² - 2 g cos).

    Cornette and Shanks raise the denominator to 1.5, so this glow is wider, and its mean is not 1.

    Source: document 004, whose g has the other sign; after Cornette & Shanks, "Physically
    reasonable analytic expression for the single-scattering phase function", 1992.

    Twin: `cheap_cornette_shanks` in `phase.glsl`.
    """
    size = jnp.abs(asymmetry)
    squared = squared_distance(cos, asymmetry)
    height = 1.5 * (1 - size) * (1 + size) / (2 + size * size)
    return height * (1 + cos * cos) / squared
