"""The paper's five passes: scene → depth textures, surface and combined air.

    1 back faces of each shadow cone   → ShadowBack        depth texture
    2 front faces of each shadow cone  → ShadowFront       depth texture
    3 the planet, with relief          → surface           colour, and the depth texture of pass 4
    4 back faces of the shell of air   → PlAtDepth         depth texture, tested against the planet
    5 front faces of the shell         → air, and the depths that the shader saw

Depths come from one of two sources. "raster": a coarse mesh around each body bounds the pixels, and
the shader finds where their rays meet sphere or cone, so that layers are as exact as float32. What
is drawn is the mesh's far side, which lies before the camera wherever the camera is. "mesh": the
paper's own, the depths of finely tessellated faces. Ground with relief is a mesh in both.

How depths are stored is the format's business (`_depth_format`). Passes 1 and 2 are drawn for the
shadows in which there is air in view; occluders are drawn with the planet, which they may hide. The
depths of all shadows share one texture, one above the other, so that there may be any number of
them. What the combine shader read is written out by shaders, so that JAX recombines the very same
numbers.
"""

from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from model_jax import InputError, Look, Scene, shadows_in_view, view_of
from model_jax._fields import uses_shadow
from model_jax._view import ShadowCone

from ._canvas import COVER_TRIANGLES, Canvas
from ._choices import Source
from ._depth_format import Storage
from ._frame import Frame
from ._looks import look_text, look_uniforms
from ._map_textures import upload_maps
from ._mesh import shadow_mesh, sphere_mesh
from ._shaders import look_program, program
from ._uniforms import aim_uniforms, cone_uniforms, defines_of

if TYPE_CHECKING:
    import moderngl

BAND = 2**20
"""Pixels drawn at once. Their textures are 80 bytes a pixel: rows of large pictures go in bands, so
that beside the images themselves there is never more of them than of a small picture."""


class Passes(Canvas):
    """The textures and the state of one drawing, and its passes in order."""

    def __init__(
        self,
        context: "moderngl.Context",
        scene: Scene,
        look: Look,
        storage: Storage,
        source: Source,
    ) -> None:
        self.exact = source == "raster"
        self.view = view_of(scene)
        self.look = type(look)
        shaded = uses_shadow(self.look.NEEDS)
        cones = zip(self.view.cones, shadows_in_view(scene), strict=True) if shaded else ()
        self.cones = [cone for cone, seen in cones if seen]
        """Shadows with air in view, if the look asks for them."""
        defines = defines_of(scene, self.look, storage, len(self.cones))
        super().__init__(context, scene, storage, defines)
        self.look_uniforms = look_uniforms(look)
        """For the combine shader alone: a look may name its own as those of other passes."""
        self.fine = scene.planet.relief is not None or not self.exact
        """Whether the ground's mesh is its shape."""
        mesh = sphere_mesh(scene.planet.triangles if self.fine else COVER_TRIANGLES)
        self.sphere, self.inner_radius = self._upload(mesh), mesh.inner_radius
        self.shell = float(self.view.shell)
        self.position = np.asarray(scene.camera.position) / float(scene.planet.radius)

    @property
    def transmits(self) -> bool:
        """Whether the combine shader writes a transmittance too."""
        return "TRANSMITS" in self.defines

    @property
    def has_water(self) -> bool:
        """Whether pass 3 writes how much of the ground mirrors too."""
        return "WATER" in self.defines

    def run(self) -> Frame:
        """All passes, band by band, and what they left."""
        width, height = self.scene.camera.width, self.scene.camera.height
        rows = self._band_rows()
        size = (height, width)
        air = np.empty((*size, 4), np.float32)
        front, back = np.empty(size, np.float32), np.empty(size, np.float32)
        shadows = np.empty((len(self.cones), 2, *size), np.float32)
        lit = self.scene.planet.albedo is not None
        surface = np.empty((*size, 3), np.float32) if lit else None
        planet = np.empty(size, np.float32)
        passed = np.empty((*size, 3), np.float32) if self.transmits else None
        water = np.empty(size, np.float32) if self.has_water else None
        maps = upload_maps(self.context, self.scene, water=self.has_water)
        for self.bottom in range(0, height, rows):
            self.size = (width, min(rows, height - self.bottom))
            band = slice(height - self.bottom - self.size[1], height - self.bottom)
            atlas = self.shadow() if self.cones else None
            ground, behind, *wet = self.planet(maps)
            self.shell_back(behind)
            air[band], front[band], back[band], *dimmed = map(
                _read, self.combine(behind, atlas, [ground, *wet])
            )
            if passed is not None:
                passed[band] = dimmed[0][..., :3]
            if atlas is not None:
                # Volume by volume from below, each with its rows from below.
                seen = self._seen(atlas).reshape(-1, 2, self.size[1], width)
                shadows[:, :, band] = seen[:, :, ::-1]
            drawn = _read(ground)
            if surface is not None:
                surface[band] = drawn[..., :3]
            planet[band] = drawn[..., 3]
            if water is not None:
                water[band] = _read(wet[0])
            self.context.gc()
        if not self.exact:
            # What the combine shader does with a back that has no front (see there).
            nearer = np.maximum if self.storage.encoding == "reversed" else np.minimum
            shadows[:, 0] = nearer(shadows[:, 0], shadows[:, 1])
        unlit = lit and "UNLIT" in self.defines
        return Frame(air, front, back, shadows, surface, unlit, planet, water, passed, self.drawn)

    def combine_again(self, repeats: int) -> list[float]:
        """Seconds of the combine pass by itself, each until the driver says that it is done.

        For pictures of one band; the passes before it are drawn once.
        """
        self.size = (self.scene.camera.width, self.scene.camera.height)
        maps = upload_maps(self.context, self.scene, water=self.has_water)
        atlas = self.shadow() if self.cones else None
        ground, behind, *wet = self.planet(maps)
        self.shell_back(behind)
        self.context.finish()
        seconds = []
        for _ in range(repeats):
            started = perf_counter()
            self.combine(behind, atlas, [ground, *wet])
            self.context.finish()
            seconds.append(perf_counter() - started)
            self.context.gc()
        return seconds

    def _band_rows(self) -> int:
        """Rows of a band: even, for derivatives are taken in squares of pixels."""
        rows = max(BAND // self.scene.camera.width // 64, 1) * 64
        if self.cones:
            limit = int(self.context.info["GL_MAX_TEXTURE_SIZE"])
            rows = min(rows, limit // (2 * len(self.cones)) // 2 * 2)
            if rows == 0:
                raise InputError(
                    f"occluder: {len(self.cones)} shadows are in view, and this driver's textures "
                    f"of {limit} rows hold {limit // 4}; remove some"
                )
        return rows

    def shadow(self) -> Any:
        """Passes 1 and 2. A cone is convex: each ray enters and leaves it once at most."""
        width, rows = self.size
        atlas = self._depth_texture(rows * 2 * len(self.cones))
        target = self._depth_only(atlas)
        for k, cone in enumerate(self.cones):
            for end in (0, 1):
                tile = (2 * k + end) * rows
                target.viewport = (0, tile - self.bottom, width, self.scene.camera.height)
                target.scissor = (0, tile, width, rows)
                target.use()
                if self.exact:
                    # Air is within the shell only, and so the shell bounds each shadow's pixels.
                    given: dict[str, Any] = cone_uniforms(cone) | {"leaving": end == 1}
                    given |= {"first_row": self.bottom - tile}
                    self._bounded(
                        "depth.frag", self.view.aim, self.shell, defines={"CONE": 1}, **given
                    )
                else:
                    self._cone_faces(target, cone, end)
        target.scissor = None
        return atlas

    def _cone_faces(self, target: Any, cone: ShadowCone, end: int) -> None:
        """The mesh's front or back faces. A camera inside sees no front face; its shadow begins at
        the near plane."""
        mesh, inside = shadow_mesh(self.scene, cone)
        if end == 0 and inside:
            self._clear(target, self.near)
            return
        self._state("front" if end else "back", test=not self.colored)
        self._volume(self._upload(mesh), "depth.frag")

    def planet(self, maps: dict[str, Any]) -> list[Any]:
        """Pass 3: surface colour, the depth texture that pass 4 goes on with, and perhaps water."""
        surface = self.context.texture(self.size, 4, dtype="f4")
        wet = [self.context.texture(self.size, 1, dtype="f4")] if self.has_water else []
        depth = self._depth_texture(self.size[1])
        if self.colored:
            buffer = self.context.depth_renderbuffer(self.size)
            target = self._target([surface, depth, *wet], buffer)
            self.context.framebuffer([surface, *wet], buffer).clear(depth=1.0)
        else:
            target = self._target([surface, *wet], depth)
            target.clear(depth=1.0)
        target.use()
        self._state("back", test=True)
        units: dict[str, Any] = {}
        for unit, (name, texture) in enumerate(maps.items()):
            texture.use(unit)  # combine has bound others since the last band
            units[name] = unit
        if self.fine:
            self._render(self.sphere, program("planet.vert", "planet.frag", self.defines), **units)
        else:
            self._bounded("planet.frag", self.view.aim, 1.0, test=True, **units)
        radius = float(self.scene.planet.radius)
        basis = np.asarray(self.scene.camera.basis())
        for body, seen in zip(self.scene.occluders, self.view.occluders, strict=True):
            center, size = tuple(basis @ np.asarray(body.center) / radius), float(seen.radius)
            if self.exact:
                self._bounded(
                    "body.frag",
                    seen.aim,
                    size,
                    test=True,
                    origin=center,
                    center_offset=center[2],
                )
            else:
                self._volume(self.sphere, "body.frag", size, center)
        return [surface, depth, *wet]

    def shell_back(self, depth: Any) -> None:
        """Pass 4: the nearer of the planet and the far side of the shell."""
        import moderngl

        self._depth_only(depth).use()
        self._state("front", test=not self.colored)
        if self.colored:
            self.context.enable(moderngl.BLEND)
            is_reversed = self.storage.encoding == "reversed"
            self.context.blend_equation = moderngl.MAX if is_reversed else moderngl.MIN
        if self.exact:
            self._bounded("depth.frag", self.view.aim, self.shell, blended=True, leaving=True)
        else:
            self._volume(self.sphere, "depth.frag", self.shell)
        self.context.blend_equation = moderngl.FUNC_ADD

    def combine(self, behind: Any, atlas: Any | None, ground: list[Any]) -> list[Any]:
        """Pass 5: the combine shader over the shell, or the screen for a camera inside its mesh.

        ground: pass 3's colour, and perhaps water.
        """
        air = self.context.texture(self.size, 4, dtype="f4")
        depths = [self.context.texture(self.size, 1, dtype="f4") for _ in range(2)]
        self.context.framebuffer([air]).clear()
        self.context.framebuffer(depths).clear(*[self.empty] * 4)
        more = [self.context.texture(self.size, 4, dtype="f4")] if self.transmits else []
        if more:
            self.context.framebuffer(more).clear(1.0, 1.0, 1.0, 1.0)
        self._target([air, *depths, *more]).use()
        units: dict[str, Any] = self.look_uniforms | {"planet_atmosphere": 0}
        units |= {"band_rows": self.size[1], "first_row": self.bottom}
        self._bind(behind, 0)
        if "planet" in self.look.NEEDS:
            ground[0].use(2)
        if self.has_water:
            ground[1].use(3)
        units |= {"ground_pass": 2, "shadow_depths": 1, "water_pass": 3}
        if atlas is not None:
            self._bind(atlas, 1)
        self._state("back", test=False)
        if self.exact:
            self._bounded("combine.frag", self.view.aim, self.shell, **units)
            return [air, *depths, *more]
        units |= aim_uniforms(self.scene.camera, self.view.aim, self.shell)
        # Inside the mesh, not just the sphere: every ray then has a back face, and no front.
        if np.linalg.norm(self.position) <= self.shell * self.inner_radius:
            self._screen("combine.frag", **units)
        else:
            self._volume(self.sphere, "combine.frag", self.shell, **units)
        return [air, *depths, *more]

    def _program(self, vertex: str, fragment: str, defines: dict[str, int]) -> Any:
        if fragment != "combine.frag":
            return program(vertex, fragment, defines)
        return look_program(vertex, fragment, defines, self.look.NAME, look_text(self.look))


def _read(texture: Any) -> Float[np.ndarray, "h w *c"]:
    """Texture to array, row 0 on top."""
    width, height = texture.size
    shape = (height, width) if texture.components == 1 else (height, width, texture.components)
    return np.frombuffer(texture.read(), dtype=np.float32).reshape(shape)[::-1]
