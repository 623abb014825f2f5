"""The text of a small scene file, whose picture has lit and shadowed air."""

SCENE = """
[camera]
position = [0.0, -20000.0, 6000.0]
target = [0.0, 0.0, 0.0]
up = [0.0, 0.0, 1.0]
fov_y_deg = 42.0
width = 160
height = 120
near = 12000.0
far = 30000.0
[planet]
radius = 6371.0
triangles = 20000
[atmosphere]
height = 600.0
color = [0.3, 0.6, 1.0]
[sun]
direction = [1.0, -0.3, 0.2]
"""


def resized(width: int, height: int) -> str:
    """The scene on a smaller picture, with a coarser mesh."""
    text = SCENE.replace("width = 160", f"width = {width}")
    text = text.replace("height = 120", f"height = {height}")
    return text.replace("triangles = 20000", "triangles = 2000")
