"""Scene and look, exact layers, the differentiable combine: pure functions of arrays.

The ground floor of airlight: it knows no files, no OpenGL, no photos and no solvers. Typical use:

    layers = analytic_layers(scene)
    picture = combine(layers, Look(brightness=3.0, shadow=0.2))
"""

from ._analytic import analytic_layers as analytic_layers
from ._analytic import limb_height as limb_height
from ._analytic import ray_stretch as ray_stretch
from ._combine import air_light as air_light
from ._combine import combine as combine
from ._combine import composite as composite
from ._combine import layer_widths as layer_widths
from ._errors import AirlightError as AirlightError
from ._errors import DriverError as DriverError
from ._errors import InputError as InputError
from ._layers import ENCODINGS as ENCODINGS
from ._layers import DepthTextures as DepthTextures
from ._layers import Encoding as Encoding
from ._layers import Layers as Layers
from ._layers import depth_constants as depth_constants
from ._layers import linearize_depth as linearize_depth
from ._look import PARAMETERS as PARAMETERS
from ._look import Look as Look
from ._look import Parameter as Parameter
from ._response import RESPONSE_PARAMETERS as RESPONSE_PARAMETERS
from ._response import Response as Response
from ._response import record as record
from ._scene import Atmosphere as Atmosphere
from ._scene import Camera as Camera
from ._scene import Occluder as Occluder
from ._scene import Planet as Planet
from ._scene import Scene as Scene
from ._scene import Sun as Sun
from ._tolerance import WidthRanges as WidthRanges
from ._tolerance import shadows_in_view as shadows_in_view
from ._tolerance import width_ranges as width_ranges
from ._tone import Exposure as Exposure
from ._tone import Linear as Linear
from ._tone import Power as Power
from ._tone import Sampled as Sampled
from ._tone import Srgb as Srgb
from ._tone import ToneCurve as ToneCurve
from ._tone import parse_tone_curve as parse_tone_curve
from ._view import eye_center as eye_center
from ._view import view_of as view_of
