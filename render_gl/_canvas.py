"""What passes are drawn with: targets whose rows are the picture's, textures of depths, and a mesh
around a sphere whose pixels a shader then finds exactly.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from model_jax import Scene
from model_jax._view import Aim

from ._depth_format import Storage
from ._frame import assign_uniforms
from ._mesh import Mesh, sphere_mesh
from ._shaders import program
from ._uniforms import aim_uniforms, plane_codes, uniforms_of

if TYPE_CHECKING:
    import moderngl

DEPTH_CLAMP = 0x864F
"""GL_DEPTH_CLAMP: what lies nearer than the near plane gets its depth instead of a hole (the
paper's extended pixel shader, its Fig. 11)."""

COVER_TRIANGLES = 5120
"""Triangles of the mesh that bounds a sphere's pixels: it is 0.12 % wider than the sphere."""

COVER_PIXELS = 1 / 16
"""More that it is wider: OpenGL snaps vertices to 1/16 pixel at worst (4 sub-pixel bits)."""


class Canvas:
    """A drawing's context, its state and its numbers."""

    def __init__(
        self,
        context: "moderngl.Context",
        scene: Scene,
        storage: Storage,
        defines: dict[str, int],
    ) -> None:
        self.context: Any = context  # its stub mistypes blend_equation
        self.scene, self.storage, self.defines = scene, storage, defines
        self.size = (scene.camera.width, 0)
        """Width and rows of a band."""
        self.bottom = 0
        """Rows of the picture below it."""
        self.drawn = 0
        """Draw calls so far."""
        self.uniforms = uniforms_of(scene, storage.encoding)
        self.near, self.empty = plane_codes(scene, storage.encoding)
        cover = sphere_mesh(COVER_TRIANGLES)
        self.cover, self.cover_radius = self._upload(cover), cover.inner_radius

    @property
    def colored(self) -> bool:
        """Whether depths go to colour attachments instead of the depth buffer."""
        return self.storage.texture is not None

    def _seen(self, atlas: Any) -> Float[np.ndarray, "rows w"]:
        """What a shader reads in a depth texture, from below."""
        if self.storage.texture == "f4":
            return np.frombuffer(atlas.read(), np.float32).reshape(atlas.size[::-1])
        copied = self.context.texture(atlas.size, 1, dtype="f4")
        self.context.framebuffer([copied]).use()
        self._state("back", test=False)
        self._bind(atlas, 0)
        self._screen("copy.frag", depths=0)
        return np.frombuffer(copied.read(), np.float32).reshape(atlas.size[::-1])

    def _depth_texture(self, rows: int) -> Any:
        """A texture for depths, cleared."""
        size = (self.size[0], rows)
        if self.colored:
            texture = self.context.texture(size, 1, dtype=self.storage.texture)
        else:
            texture = self.context.depth_texture(size)
        self._clear(self._depth_only(texture), self.empty)
        return texture

    def _clear(self, target: Any, depth: float) -> None:
        """All of a framebuffer of depths only, or its scissor."""
        box = target.scissor
        if self.colored:
            target.clear(depth, depth, depth, depth, viewport=box)
        else:
            target.clear(depth=depth, viewport=box)

    def _depth_only(self, texture: Any) -> Any:
        """A framebuffer without colour: one that a program leaves unwritten would be undefined."""
        return self._target([texture]) if self.colored else self._target((), texture)

    def _target(self, colors: Any, depth: Any = None) -> Any:
        """A framebuffer whose rows are the picture's at this band."""
        target = self.context.framebuffer(colors, depth)
        target.viewport = (0, -self.bottom, self.size[0], self.scene.camera.height)
        return target

    def _state(self, culled: str, test: bool) -> None:
        import moderngl

        self.context.enable_only(moderngl.CULL_FACE | (moderngl.DEPTH_TEST if test else 0))
        self.context.enable_direct(DEPTH_CLAMP)
        self.context.cull_face = culled
        self.context.depth_func = "<="

    def _bind(self, texture: Any, unit: int) -> None:
        import moderngl

        if not self.colored:
            texture.compare_func = ""  # depth textures compare by default; we want the values
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.use(unit)

    def _upload(self, mesh: Mesh) -> tuple[Any, Any]:
        return (
            self.context.buffer(mesh.vertices.astype(np.float32).tobytes()),
            self.context.buffer(mesh.triangles.tobytes()),
        )

    def _volume(
        self,
        geometry: tuple[Any, Any],
        fragment: str,
        size: float = 1.0,
        origin: tuple[float, ...] = (0.0, 0.0, 0.0),
        **more: Any,
    ) -> None:
        shader = self._program("volume.vert", fragment, self.defines)
        self._render(geometry, shader, size=size, origin=origin, **more)

    def _bounded(
        self,
        fragment: str,
        aim: Aim,
        radius: float,
        *,
        defines: dict[str, int] | None = None,
        test: bool | None = None,
        blended: bool = False,
        **more: Any,
    ) -> None:
        """Run a shader where rays may meet a sphere: on the far side of a mesh around it.

        A camera in or near the mesh gets a larger one, for all of its rays must meet the far side.
        """
        if not blended:
            self._state("front", test=not self.colored if test is None else test)
        distance = float(np.linalg.norm(aim.center))
        size = (radius + COVER_PIXELS * self._footprint(distance + radius)) / self.cover_radius
        if distance < 1.1 * size:
            size = 1.2 * distance / self.cover_radius + size
        defines = self.defines | (defines or {}) | {"EXACT": 1}
        shader = self._program("volume.vert", fragment, defines)
        found = aim_uniforms(self.scene.camera, aim, radius) | {"first_row": self.bottom}
        found |= {"origin": (0.0, 0.0, 0.0), "size": size}
        self._render(self.cover, shader, **(found | more))

    def _footprint(self, distance: float) -> float:
        """What a pixel covers at a distance, planet radii; no ray is longer than the diagonal's."""
        camera = self.scene.camera
        pixel = float(camera.pixel_size())
        slope = pixel * np.hypot(camera.width, camera.height) / 2
        return float(pixel * distance * (1 + slope**2))

    def _screen(self, fragment: str, **more: Any) -> None:
        shader = self._program("screen.vert", fragment, self.defines)
        assign_uniforms(shader, self.uniforms | more)
        self.context.vertex_array(shader, []).render(vertices=3)
        self.drawn += 1

    def _program(self, vertex: str, fragment: str, defines: dict[str, int]) -> Any:
        return program(vertex, fragment, defines)

    def _render(self, geometry: tuple[Any, Any], shader: Any, **more: Any) -> None:
        assign_uniforms(shader, self.uniforms | more)
        vertices, triangles = geometry
        content = [(vertices, "3f", "position")]
        self.context.vertex_array(shader, content, triangles).render()
        self.drawn += 1
