"""Fit the look of an atmosphere to a photo: photo and layers in, values with error bars out.

The top floor of airlight. Its core needs arrays and `model_jax` only, so it works where there is no
OpenGL:

    result = fit(load_photo("photo.png"), layers)
    print(result.message, result.parameters["brightness"])
"""

from ._fit import fit as fit
from ._photo import Photo as Photo
from ._photo import load_photo as load_photo
from ._result import VERDICTS as VERDICTS
from ._result import Errors as Errors
from ._result import Estimate as Estimate
from ._result import FitResult as FitResult
from ._result import LeftOut as LeftOut
from ._result import PhotoResult as PhotoResult
from ._result import Verdict as Verdict
from ._traced import TracedFit as TracedFit
