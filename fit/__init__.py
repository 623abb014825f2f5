"""Fit the look of an atmosphere to a photo: photo and layers in, values with error bars out.

The top floor of airlight. Its core needs arrays and `model_jax` only, so it works where there is no
OpenGL:

    result = fit(load_photo("photo.png"), layers)
    print(result)
"""

import lazy_loader

# What `__init__.pyi` lists is imported when first used: JAX alone takes seconds.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
