"""The paper's five passes: scene → depth textures, surface and combined air.

    1 back faces of the shadow cone    → ShadowBack        depth texture
    2 front faces of the shadow cone   → ShadowFront       depth texture
    3 the planet, with relief          → surface           colour, and the depth texture of pass 4
    4 back faces of the shell of air   → PlAtDepth         depth texture, tested against the planet
    5 front faces of the shell         → air, and the four depths that the shader saw

Depth formats: "window24", the paper's 24-bit depth textures, and "linear", float32 eye depth
relative to the planet's centre in a colour attachment. Passes 1 and 2 are left out when no air in
view is in shadow, or the scene has no sun. What the combine shader read is written out by the
shader itself, so that JAX recombines the very same numbers.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from model_jax import DriverError, InputError, Look, Scene, refuse_occluders, shadow_in_view

from ._context import gl_context
from ._maps import load_albedo, load_relief
from ._mesh import Mesh, shadow_mesh, sphere_mesh
from ._shaders import program
from ._uniforms import defines_of, uniforms_of

if TYPE_CHECKING:
    import moderngl

DepthFormat = Literal["window24", "linear"]
DEPTH_FORMATS: tuple[DepthFormat, ...] = ("window24", "linear")

DEPTH_CLAMP = 0x864F
"""GL_DEPTH_CLAMP: what lies nearer than the near plane gets its depth instead of a hole (the
paper's extended pixel shader, its Fig. 11)."""

MAX_WINDOW_RATIO = 1e7
"""The linearisation's `a` is 1 + near/far: at this ratio that is less than one float32 step from 1,
and far depths become arbitrary or infinite."""

BAND = 2**20
"""Pixels drawn at once. Their textures are 80 bytes a pixel: rows of large pictures go in bands, so
that beside the images themselves there is never more of them than of a small picture."""

SHADOW_MARGIN = 1.01
"""The cone is drawn to this many shell radii from the planet's centre; beyond is no air."""


@dataclass(frozen=True)
class Frame:
    """What the passes left, as images with row 0 on top."""

    air: Float[np.ndarray, "h w 4"]
    """The combine shader's output."""
    depths: tuple[Float[np.ndarray, "h w"], ...]
    """What it read: front, back and, if the shadow passes were drawn, shadow front, shadow back;
    equal front and back without air."""
    surface: Float[np.ndarray, "h w 3"] | None
    """Light of the planet; None where it has no albedo."""
    planet: Float[np.ndarray, "h w"]
    """1 where the planet was drawn."""


def draw(scene: Scene, look: Look, depth_format: DepthFormat) -> Frame:
    """Draw a scene.

    Raises `DriverError` when there is no driver or it fails, `InputError` for an unknown format, a
    picture or texture beyond the driver's limit, unreadable maps, and occluders.
    """
    if depth_format not in DEPTH_FORMATS:
        raise InputError(f"depth format {depth_format!r} is unknown; use one of {DEPTH_FORMATS}")
    refuse_occluders(scene)
    ratio = float(scene.camera.far / scene.camera.near)
    if depth_format == "window24" and ratio >= MAX_WINDOW_RATIO:
        raise InputError(
            f"camera.far / camera.near: {ratio:.3g} is beyond what window depths can hold "
            f"(below {MAX_WINDOW_RATIO:.0e}); bring the planes together or use linear depth"
        )
    context = gl_context()
    _check_size(context, "camera", scene.camera.width, scene.camera.height)
    try:
        frame = _Passes(context, scene, look, depth_format == "linear").run()
    finally:
        context.gc()  # so that a thousand renders need no more memory than one
    if (error := context.error) != "GL_NO_ERROR":
        raise DriverError(f"OpenGL reports {error} after drawing; the driver may be out of memory")
    return frame


def assign_uniforms(shader: "moderngl.Program", values: dict[str, Any]) -> None:
    """Give a program its uniforms by name; one that `values` lacks is a `KeyError`."""
    import moderngl

    for name in shader:
        member = shader[name]
        if isinstance(member, moderngl.Uniform):
            member.value = values[name]


class _Passes:
    """The textures and the state of one drawing, and its passes in order."""

    def __init__(self, context: "moderngl.Context", scene: Scene, look: Look, linear: bool) -> None:
        self.context: Any = context  # its stub mistypes blend_equation
        self.scene, self.linear = scene, linear
        self.size = (scene.camera.width, 0)
        """Of a band."""
        self.bottom = 0
        """Rows of the picture below it."""
        self.uniforms = uniforms_of(scene, look, linear)
        self.shadowed = shadow_in_view(scene)
        self.defines = defines_of(scene, linear, self.shadowed)
        mesh = sphere_mesh(scene.planet.triangles)
        self.sphere, self.inner_radius = self._upload(mesh), mesh.inner_radius
        self.shell = float(1 + scene.atmosphere.height / scene.planet.radius)
        self.position = np.asarray(scene.camera.position) / float(scene.planet.radius)

    def run(self) -> Frame:
        """All passes, band by band, and what they left."""
        width, height = self.scene.camera.width, self.scene.camera.height
        rows = max(BAND // width // 64, 1) * 64  # even: derivatives are taken in squares of pixels
        size = (height, width)
        air = np.empty((*size, 4), np.float32)
        depths = [np.empty(size, np.float32) for _ in range(4 if self.shadowed else 2)]
        lit = self.scene.planet.albedo is not None
        surface = np.empty((*size, 3), np.float32) if lit else None
        planet = np.empty(size, np.float32)
        maps = _upload_maps(self.context, self.scene)
        for self.bottom in range(0, height, rows):
            self.size = (width, min(rows, height - self.bottom))
            band = slice(height - self.bottom - self.size[1], height - self.bottom)
            drawn, seen, ground = map(_read, self._band(maps))
            air[band] = drawn
            for k, depth in enumerate(depths):
                depth[band] = seen[..., k]
            if surface is not None:
                surface[band] = ground[..., :3]
            planet[band] = ground[..., 3]
            self.context.gc()
        return Frame(air, tuple(depths), surface, planet)

    def _band(self, maps: dict[str, Any]) -> tuple[Any, Any, Any]:
        """Air, depths and surface of a band."""
        textures = self.shadow() if self.shadowed else {}
        surface, textures["planet_atmosphere"] = self.planet(maps)
        self.shell_back(textures["planet_atmosphere"])
        air, depths = self.combine(textures)
        return air, depths, surface

    def shadow(self) -> dict[str, Any]:
        """Passes 1 and 2. A cone is convex: each ray meets one back and one front face at most.

        A camera inside sees no front face; its shadow begins at the near plane.
        """
        mesh, inside = _shadow(self.scene, self.shell, self.position)
        cone = self._upload(mesh)
        empty = self.uniforms["empty"]
        near = (
            self.uniforms["clip_planes"][0] * self.uniforms["length_unit"] if self.linear else 0.0
        )
        textures = {}
        for name, culled, clear in (
            ("shadow_back_texture", "front", empty),
            ("shadow_front_texture", "back", near if inside else empty),
        ):
            textures[name] = self._depth_texture(clear)
            self._depth_only(textures[name]).use()
            self._state(culled, test=not self.linear)
            self._render(cone, program("volume.vert", "depth.frag", self.defines), size=1.0)
        return textures

    def planet(self, maps: dict[str, Any]) -> tuple[Any, Any]:
        """Pass 3: surface colour, and the depth texture that pass 4 goes on with."""
        surface = self.context.texture(self.size, 4, dtype="f4")
        depth = self._depth_texture(self.uniforms["empty"])
        if self.linear:
            target = self._target([surface, depth], self.context.depth_renderbuffer(self.size))
            self.context.framebuffer([surface], target.depth_attachment).clear(depth=1.0)
        else:
            target = self._target([surface], depth)
            target.clear(depth=1.0)
        target.use()
        self._state("back", test=True)
        units = {}
        for unit, (name, texture) in enumerate(maps.items()):
            texture.use(unit)  # combine has bound others since the last band
            units[name] = unit
        self._render(self.sphere, program("planet.vert", "planet.frag", self.defines), **units)
        return surface, depth

    def shell_back(self, depth: Any) -> None:
        """Pass 4: the nearer of the planet and the far side of the shell."""
        import moderngl

        self._depth_only(depth).use()
        self._state("front", test=not self.linear)
        if self.linear:
            self.context.enable(moderngl.BLEND)
            self.context.blend_equation = moderngl.MIN
        self._render(
            self.sphere, program("volume.vert", "depth.frag", self.defines), size=self.shell
        )
        self.context.blend_equation = moderngl.FUNC_ADD

    def combine(self, textures: dict[str, Any]) -> tuple[Any, Any]:
        """Pass 5: the combine shader over the shell's front, or the screen for a camera inside."""
        import moderngl

        air = self.context.texture(self.size, 4, dtype="f4")
        depths = self.context.texture(self.size, 4, dtype="f4")
        self.context.framebuffer([air]).clear()
        self.context.framebuffer([depths]).clear(*[self.uniforms["empty"]] * 4)
        self._target([air, depths]).use()
        units = {}
        for unit, (name, texture) in enumerate(textures.items()):
            if not self.linear:
                texture.compare_func = ""  # depth textures compare by default; we want the values
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.use(unit)
            units[name] = unit
        self._state("back", test=False)
        # Inside the mesh, not just the sphere: every ray then has a back face, and no front.
        if np.linalg.norm(self.position) <= self.shell * self.inner_radius:
            screen = program("screen.vert", "combine.frag", self.defines)
            assign_uniforms(screen, self.uniforms | units)
            self.context.vertex_array(screen, []).render(vertices=3)
        else:
            shader = program("volume.vert", "combine.frag", self.defines)
            self._render(self.sphere, shader, size=self.shell, **units)
        return air, depths

    def _depth_texture(self, clear: float) -> Any:
        """A texture for depths, cleared: depth buffer, or float32 colour for linear depths."""
        if self.linear:
            texture = self.context.texture(self.size, 1, dtype="f4")
            self._depth_only(texture).clear(clear, clear, clear, clear)
        else:
            texture = self.context.depth_texture(self.size)
            self._depth_only(texture).clear(depth=clear)
        return texture

    def _depth_only(self, texture: Any) -> Any:
        """A framebuffer without colour: one that a program leaves unwritten would be undefined."""
        return self._target([texture]) if self.linear else self._target((), texture)

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

    def _upload(self, mesh: Mesh) -> tuple[Any, Any]:
        return (
            self.context.buffer(mesh.vertices.astype(np.float32).tobytes()),
            self.context.buffer(mesh.triangles.tobytes()),
        )

    def _render(self, geometry: tuple[Any, Any], shader: Any, **more: Any) -> None:
        assign_uniforms(shader, self.uniforms | more)
        vertices, triangles = geometry
        content = [(vertices, "3f", "position")]
        self.context.vertex_array(shader, content, triangles).render()


def _shadow(scene: Scene, shell: float, position: Float[np.ndarray, "3"]) -> tuple[Mesh, bool]:
    """The planet's shadow cone, and whether the camera stands in the drawn part of it."""
    assert scene.sun is not None
    toward = np.asarray(scene.sun.direction)
    tangent = float(np.tan(np.deg2rad(scene.sun.angular_radius_deg)))
    length = SHADOW_MARGIN * shell
    along = -float(position @ toward)
    across = float(np.linalg.norm(position + along * toward))
    inside = 0 < along < length and across < 1 - tangent * along
    return shadow_mesh(toward, tangent, 1.0, length), inside


def _upload_maps(context: "moderngl.Context", scene: Scene) -> dict[str, Any]:
    """Textures of relief and albedo, by the names of their samplers."""
    import moderngl

    maps = {}
    if scene.planet.relief is not None:
        unit = np.float32(float(scene.planet.relief_unit) / float(scene.planet.radius))
        heights = load_relief(scene.planet.relief) * unit
        rows, columns = heights.shape
        _check_size(context, scene.planet.relief, columns, rows)
        relief = context.texture((columns, rows), 1, heights.tobytes(), dtype="f4")
        relief.repeat_y = False
        maps["relief"] = relief
    if scene.planet.albedo is not None:
        colors = load_albedo(scene.planet.albedo)
        rows, columns, _ = colors.shape
        _check_size(context, scene.planet.albedo, columns, rows)
        albedo = context.texture((columns, rows), 3, colors.tobytes(), dtype="f2", alignment=1)
        albedo.build_mipmaps()
        albedo.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        albedo.repeat_y = False
        maps["albedo"] = albedo
    return maps


def _check_size(context: "moderngl.Context", what: str, width: int, height: int) -> None:
    limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
    if max(width, height) > limit:
        raise InputError(
            f"{what}: {width}×{height} pixels exceed this driver's limit of {limit}; "
            "make it smaller"
        )


def _read(texture: Any) -> Float[np.ndarray, "h w 4"]:
    """Texture to array, row 0 on top: the one place where OpenGL's bottom-up rows are turned."""
    width, height = texture.size
    return np.frombuffer(texture.read(), dtype=np.float32).reshape(height, width, 4)[::-1]
