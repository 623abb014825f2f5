"""OpenGL beside other contexts and threads: whoever calls, from wherever, in whatever order."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from ctypes import CDLL, c_void_p
from typing import Any

import jax
import moderngl
import numpy as np
import pytest

import render_gl
from model_jax import DriverError, InputError, LayersLook
from render_gl import _context

from ..fit.looks import scene


def current() -> int | None:
    """Address of the context that is current in this thread."""
    get = CDLL("libEGL.so.1").eglGetCurrentContext
    get.restype = c_void_p
    return get()


def another() -> moderngl.Context:
    settings: Any = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
    return moderngl.create_context(standalone=True, **settings)


def test_another_context_is_left_alone_and_takes_nothing_away() -> None:
    expected = render_gl.render(scene(), "linear").front
    first = another()
    mine = current()
    np.testing.assert_array_equal(render_gl.render(scene(), "linear").front, expected)
    assert current() == mine
    assert moderngl.get_context() is first
    texture = first.texture((2, 2), 4, bytes(range(16)))
    second = another()
    with second:
        np.testing.assert_array_equal(render_gl.render(scene(), "linear").front, expected)
    second.release()
    np.testing.assert_array_equal(render_gl.render(scene(), "linear").front, expected)
    with first:
        np.testing.assert_array_equal(render_gl.render(scene(), "linear").front, expected)
        assert texture.read() == bytes(range(16))
    first.release()
    np.testing.assert_array_equal(render_gl.render(scene(), "linear").front, expected)


def test_the_first_render_after_anothers_context_leaves_it_current() -> None:
    """In a process of its own: here a context has long been opened."""
    run("""
import moderngl
from tests.render_gl.test_context import another, current
own = another()
mine = current()
render_gl.render(scene(), "linear")
assert current() == mine and moderngl.get_context() is own
""")


def test_threads_take_turns() -> None:
    expected = render_gl.render(scene(), "window24").front
    with ThreadPoolExecutor(4) as pool:
        for layers in pool.map(lambda _: render_gl.render(scene(), "window24"), range(12)):
            np.testing.assert_array_equal(layers.front, expected)


def test_numbers_of_jax_are_drawn_as_they_are_whatever_the_threads_setting() -> None:
    expected = render_gl.render(scene(), "linear")
    with jax.enable_x64(True):
        case = jax.tree.map(jax.numpy.asarray, scene())
        found = render_gl.render(case, "linear")
    np.testing.assert_array_equal(found.front, expected.front)
    np.testing.assert_array_equal(found.shadow_back, expected.shadow_back)


def test_a_traced_look_is_refused() -> None:
    def image(brightness: jax.Array) -> jax.Array | np.ndarray:
        return render_gl.render_image(scene(), LayersLook(brightness=brightness), "linear")

    with pytest.raises(InputError, match=r"traced.*outside of jit"):
        jax.jit(image)(3.0)


def run(program: str) -> list[str]:
    """Lines that a program prints in a process of its own."""
    head = "import render_gl\nfrom tests.fit.looks import scene\n"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", head + program],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_a_forked_process_is_told_to_be_spawned() -> None:
    [line] = run("""
import os
render_gl.render(scene(), "linear")
if os.fork():
    os.wait()
else:
    try:
        render_gl.render(scene(), "linear")
    except Exception as error:
        print(type(error).__name__, error, flush=True)
    os._exit(0)
""")
    assert line.startswith("DriverError process ")
    assert "method 'spawn'" in line


def test_a_process_that_ends_is_told_so() -> None:
    [line] = run("""
import atexit
render = render_gl.render  # imported before the end, when Python starts no more threads
@atexit.register
def draw():
    try:
        render(scene(), "linear")
    except Exception as error:
        print(type(error).__name__, error)
""")
    assert line.startswith("DriverError OpenGL: ")
    assert line.endswith("draw before the program ends")


def test_without_a_driver_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(**settings: object) -> None:
        raise Exception("cannot load libEGL")

    monkeypatch.setattr(moderngl, "create_context", fail)
    with pytest.raises(DriverError, match="apt-get install libegl1") as caught:
        _context._context.__wrapped__()  # past the cache, which may hold a good context
    assert "\n" not in str(caught.value)
