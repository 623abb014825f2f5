"""Layers by OpenGL: scene files, the paper's five passes, layer files, the cross-check.

The middle floor of airlight: it knows OpenGL and files, and nothing of fitting. OpenGL itself is
loaded when something is first drawn, so that files can be read and written without a driver.
"""

from ._check import Check as Check
from ._check import check_scene as check_scene
from ._context import renderer_name as renderer_name
from ._depth_format import DEPTH_FORMATS as DEPTH_FORMATS
from ._depth_format import Choice as Choice
from ._depth_format import DepthFormat as DepthFormat
from ._depth_format import choose_format as choose_format
from ._draw import SOURCES as SOURCES
from ._draw import Source as Source
from ._exr import read_channels as read_channels
from ._exr import write_channels as write_channels
from ._files import write_whole as write_whole
from ._layers_file import read_layers as read_layers
from ._layers_file import write_layers as write_layers
from ._layers_file import write_picture as write_picture
from ._render import render as render
from ._render import render_image as render_image
from ._scene_file import SceneFile as SceneFile
from ._scene_file import load_scene as load_scene
from ._scene_file import scene_hash as scene_hash
from ._scene_file import scene_record as scene_record
