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
[look]
kind = "layers"
"""


def resized(width: int, height: int) -> str:
    """The scene on a smaller picture, with a coarser mesh."""
    text = SCENE.replace("width = 160", f"width = {width}")
    text = text.replace("height = 120", f"height = {height}")
    return text.replace("triangles = 20000", "triangles = 2000")


DIGITS = "1" + "0" * 400
HEX = "0x" + "f" * 5000


NASTY = [
    *("", "nan", "-inf", "1e400", "-0.0", "5e-324", "1e308", "-1", "0", DIGITS, HEX, "1_0", "true"),
    *("[]", "[[]]", "{}", "[nan, 1, 1]", "[1e308, -1e308, 1e308]", "[5e-324, 0, 0]", "{a.b = 1}"),
    *('""', '"\\u0000"', '"\\u001b"', '"\\ud800"', "'" + "x" * 300 + "'", '"""\n"""', "1979-05-27"),
    *("07:32:00", "1979-02-31", "[" * 2000, "{a=" * 2000, "1" * 5000, "0.5", "1", "[0, 1]", "x"),
]
