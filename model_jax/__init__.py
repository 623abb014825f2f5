"""Scene and look, exact layers, the differentiable combine: pure functions of arrays.

The ground floor of airlight: it knows no files, no OpenGL, no photos and no solvers. Typical use:

    layers = analytic_layers(scene)
    picture = combine(layers, LayersLook(brightness=3.0, shadow=0.2))
"""

import lazy_loader

# What `__init__.pyi` lists is imported when first used: JAX alone takes seconds.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
