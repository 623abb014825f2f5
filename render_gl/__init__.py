"""Layers by OpenGL: scene files, the paper's five passes, layer files, the cross-check.

The middle floor of airlight: it knows OpenGL and files, and nothing of fitting. OpenGL itself is
loaded when something is first drawn, so that files can be read and written without a driver.
"""

import lazy_loader

# What `__init__.pyi` lists is imported when first used: JAX alone takes seconds.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
