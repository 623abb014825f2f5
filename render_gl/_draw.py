"""The paper's five passes: scene → depth textures, surface and combined air.

    1 back faces of the shadow cone    → ShadowBack        depth texture
    2 front faces of the shadow cone   → ShadowFront       depth texture
    3 the planet, with relief          → surface           colour, and the depth texture of pass 4
    4 back faces of the shell of air   → PlAtDepth         depth texture, tested against the planet
    5 front faces of the shell         → air, and the four depths that the shader saw

Depth formats: "window24", the paper's 24-bit depth textures, and "linear", float32 eye depth
relative to the planet's centre. Passes 1 and 2 are left out when the scene has no sun. What the
combine shader read is written out by itself, so that JAX recombines the very same numbers.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from model_jax import DriverError, InputError, Look, Scene, depth_constants

from ._context import gl_context
from ._maps import load_albedo, load_relief
from ._mesh import Mesh, shadow_mesh, sphere_mesh
from ._shaders import program

if TYPE_CHECKING:
    import moderngl

DepthFormat = Literal["window24", "linear"]
DEPTH_FORMATS: tuple[DepthFormat, ...] = ("window24", "linear")

DEPTH_CLAMP = 0x864F
"""GL_DEPTH_CLAMP: what lies nearer than the near plane gets its depth instead of a hole (the
paper's extended pixel shader, its Fig. 11)."""

SHADOW_MARGIN = 1.01
"""The cone is drawn to this many shell radii from the planet's centre; beyond is no air."""


@dataclass(frozen=True)
class Frame:
    """What the passes left, as images with row 0 on top."""

    air: Float[np.ndarray, "h w 4"]
    """The combine shader's output."""
    depths: Float[np.ndarray, "h w 4"]
    """What it read: front, back, shadow front, shadow back; equal front and back without air."""
    surface: Float[np.ndarray, "h w 4"]
    """Light of the planet, and 1 in alpha where it was drawn."""


def draw(scene: Scene, look: Look, depth_format: DepthFormat) -> Frame:
    """Draw a scene.

    Raises `DriverError` when there is no driver or it fails, `InputError` for an unknown format, a
    picture or texture beyond the driver's limit, unreadable maps, and occluders.
    """
    if depth_format not in DEPTH_FORMATS:
        raise InputError(f"depth format {depth_format!r} is unknown; use one of {DEPTH_FORMATS}")
    if scene.occluders:
        raise InputError(
            f"occluder: {len(scene.occluders)} given, but shadows of further bodies are not drawn "
            "yet; remove [[occluder]]"
        )
    context = gl_context()
    camera = scene.camera
    _check_size(context, "camera", camera.width, camera.height)
    with _resources(context):
        frame = _draw(context, scene, look, depth_format)
    if (error := context.error) != "GL_NO_ERROR":
        raise DriverError(f"OpenGL reports {error} after drawing; the driver may be out of memory")
    return frame


def _draw(
    context: "moderngl.Context", scene: Scene, look: Look, depth_format: DepthFormat
) -> Frame:
    import moderngl

    camera, size = scene.camera, (scene.camera.width, scene.camera.height)
    linear = depth_format == "linear"
    uniforms = _uniforms(scene, look, linear)
    defines = _defines(scene, linear)
    sphere = _geometry(sphere_mesh(scene.planet.triangles))
    shell = float(1 + scene.atmosphere.height / scene.planet.radius)
    position = np.asarray(camera.position) / float(scene.planet.radius)
    inside_air = bool(np.linalg.norm(position) <= shell)
    uniforms["size"] = 1.0
    context.enable_direct(DEPTH_CLAMP)
    context.depth_func = "<="

    def depth_texture() -> Any:
        if linear:
            return context.texture(size, 1, dtype="f4")
        return context.depth_texture(size)

    def target(texture: Any, clear: float) -> Any:
        framebuffer = (
            context.framebuffer([texture]) if linear else context.framebuffer((), texture)
        )
        framebuffer.use()
        if linear:
            framebuffer.clear(clear, clear, clear, clear)
        else:
            framebuffer.clear(depth=clear)
        return framebuffer

    near_value = float(uniforms["clip_planes"][0] * uniforms["length_unit"]) if linear else 0.0
    empty = uniforms["empty"]

    # Passes 1 and 2. A cone is convex, so each ray meets one back and one front face at most; a
    # camera inside sees no front face, and its shadow begins at the near plane.
    shadow_textures = {}
    if scene.sun is not None:
        mesh, inside_shadow = _shadow(scene, shell, position)
        cone = _geometry(mesh)
        volume = program("volume.vert", "depth.frag", defines)
        for name, culled, clear in (
            ("shadow_back_texture", "front", empty),
            ("shadow_front_texture", "back", near_value if inside_shadow else empty),
        ):
            shadow_textures[name] = depth_texture()
            target(shadow_textures[name], clear)
            context.cull_face = culled
            context.enable_only(moderngl.CULL_FACE if linear else _DEPTH_AND_CULL())
            context.enable_direct(DEPTH_CLAMP)
            _render(context, cone, volume, uniforms)

    # Pass 3.
    surface = context.texture(size, 4, dtype="f4")
    planet_atmosphere = depth_texture()
    if linear:
        planes, zbuffer = [surface, planet_atmosphere], context.depth_renderbuffer(size)
    else:
        planes, zbuffer = [surface], planet_atmosphere
    ground = context.framebuffer(planes, zbuffer)
    ground.use()
    ground.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
    if linear:
        context.framebuffer([planet_atmosphere]).clear(empty, empty, empty, empty)
        ground.use()
    context.cull_face = "back"
    context.enable_only(_DEPTH_AND_CULL())
    context.enable_direct(DEPTH_CLAMP)
    maps = _bind_maps(context, scene, defines)
    _render(context, sphere, program("planet.vert", "planet.frag", defines), uniforms | maps)

    # Pass 4.
    uniforms["size"] = shell
    if linear:
        context.framebuffer([planet_atmosphere]).use()
        context.enable_only(moderngl.CULL_FACE | moderngl.BLEND)
        context.blend_equation = moderngl.MIN
        context.blend_func = moderngl.ONE, moderngl.ONE
    else:
        context.framebuffer((), planet_atmosphere).use()
    context.enable_direct(DEPTH_CLAMP)
    context.cull_face = "front"
    _render(context, sphere, program("volume.vert", "depth.frag", defines), uniforms)
    context.blend_equation = moderngl.FUNC_ADD

    # Pass 5.
    air, depths = context.texture(size, 4, dtype="f4"), context.texture(size, 4, dtype="f4")
    final = context.framebuffer([air, depths])
    context.framebuffer([depths]).clear(empty, empty, empty, empty)
    context.framebuffer([air]).clear(0.0, 0.0, 0.0, 0.0)
    final.use()
    textures = {"planet_atmosphere": planet_atmosphere} | shadow_textures
    for unit, (name, texture) in enumerate(textures.items()):
        if not linear:
            texture.compare_func = ""  # depth textures compare by default; the values are wanted
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.use(unit)
        uniforms[name] = unit
    if inside_air:
        context.enable_only(moderngl.NOTHING)
        screen = program("screen.vert", "combine.frag", defines)
        assign_uniforms(screen, uniforms)
        context.vertex_array(screen, []).render(vertices=3)
    else:
        context.enable_only(moderngl.CULL_FACE)
        context.enable_direct(DEPTH_CLAMP)
        context.cull_face = "back"
        _render(context, sphere, program("volume.vert", "combine.frag", defines), uniforms)
    return Frame(_read(air), _read(depths), _read(surface))


def _DEPTH_AND_CULL() -> int:
    import moderngl

    return moderngl.DEPTH_TEST | moderngl.CULL_FACE


def _uniforms(scene: Scene, look: Look, linear: bool) -> dict[str, Any]:
    """Every number the shaders take from the scene and the look, from float64."""
    camera, radius = scene.camera, float(scene.planet.radius)
    near, far = float(camera.near), float(camera.far)
    basis = np.asarray(camera.basis())
    center = -basis @ np.asarray(camera.position) / radius
    focal_y = 2.0 / (camera.height * float(camera.pixel_size()))
    color = np.asarray(scene.atmosphere.color)
    return {
        "basis": tuple(basis.T.reshape(-1)),  # GL wants columns
        "center": tuple(center[:2]),
        "center_depth": center[2],
        "clip_planes": (near / radius - center[2], far / radius - center[2]),
        "clip_factors": (far / (far - near), near / (far - near)),
        "focal": (focal_y * camera.height / camera.width, focal_y),
        "length_unit": radius,
        "empty": far - center[2] * radius if linear else 1.0,
        "depth_constants": depth_constants(near, far),
        "width_unit": far - near,
        "brightness": float(look.brightness),
        "shadow": tuple(np.broadcast_to(look.shadow, 3)),
        "color": (*(color[:3] * np.asarray(look.tint)), color[3]),
        "relief_scale": _relief_scale(scene, float(np.linalg.norm(center)) - 1.0),
        "sun": (0.0, 0.0, 0.0) if scene.sun is None else tuple(np.asarray(scene.sun.direction)),
    }


def _relief_scale(scene: Scene, height: float) -> float:
    """Exaggeration of the relief for a camera `height` radii above the ground.

    The paper changes it with the camera's distance and gives no curve; here it runs from the near
    to the far scale with the logarithm of the height.
    """
    (near, far), (low, high) = scene.planet.relief_distance, scene.planet.relief_scale
    start = max(near, 1e-9)
    share = np.log(max(height, start) / start) / np.log(far / start)
    return float(low + (high - low) * np.clip(share, 0.0, 1.0))


def _defines(scene: Scene, linear: bool) -> frozenset[str]:
    wanted = {
        "LINEAR": linear,
        "SHADOW": scene.sun is not None,
        "SUN": scene.sun is not None,
        "ALBEDO": scene.planet.albedo is not None,
        "RELIEF": scene.planet.relief is not None,
    }
    return frozenset(name for name, on in wanted.items() if on)


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


def _bind_maps(
    context: "moderngl.Context", scene: Scene, defines: frozenset[str]
) -> dict[str, Any]:
    """Upload relief and albedo; returns the sampler uniforms."""
    import moderngl

    bound: dict[str, Any] = {}
    radius = float(scene.planet.radius)
    if scene.planet.relief is not None:
        heights = load_relief(scene.planet.relief) * np.float32(
            float(scene.planet.relief_unit) / radius
        )
        _check_size(context, scene.planet.relief, heights.shape[1], heights.shape[0])
        relief = context.texture(heights.shape[::-1], 1, heights.tobytes(), dtype="f4")
        relief.repeat_y = False
        relief.use(0)
        bound["relief"] = 0
    if scene.planet.albedo is not None:
        colors = load_albedo(scene.planet.albedo)
        _check_size(context, scene.planet.albedo, colors.shape[1], colors.shape[0])
        albedo = context.texture(colors.shape[1::-1], 3, colors.tobytes(), dtype="f2", alignment=1)
        albedo.build_mipmaps()
        albedo.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        albedo.repeat_y = False
        albedo.use(1)
        bound["albedo"] = 1
    return bound


def _geometry(mesh: Mesh) -> tuple[Any, Any]:
    context = gl_context()
    return (
        context.buffer(mesh.vertices.astype(np.float32).tobytes()),
        context.buffer(mesh.triangles.tobytes()),
    )


def _render(
    context: "moderngl.Context", geometry: tuple[Any, Any], shader: Any, uniforms: dict[str, Any]
) -> None:
    assign_uniforms(shader, uniforms)
    vertices, triangles = geometry
    context.vertex_array(shader, [(vertices, "3f", "position")], triangles).render()


def assign_uniforms(shader: Any, uniforms: dict[str, Any]) -> None:
    for name in shader:
        if type(shader[name]).__name__ == "Uniform":
            shader[name].value = uniforms[name]


@contextmanager
def _resources(context: "moderngl.Context") -> Iterator[None]:
    """Frees what was made inside, so that a thousand renders need no more memory than one."""
    try:
        yield
    finally:
        context.gc()


def _check_size(context: "moderngl.Context", what: str, width: int, height: int) -> None:
    limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
    if max(width, height) > limit:
        raise InputError(
            f"{what}: {width}×{height} pixels exceed this driver's limit of {limit}; make it smaller"
        )


def _read(texture: Any) -> Float[np.ndarray, "h w 4"]:
    """Texture to array, row 0 on top: the one place where OpenGL's bottom-up rows are turned."""
    width, height = texture.size
    values = np.frombuffer(texture.read(), dtype=np.float32).reshape(height, width, 4)
    return np.ascontiguousarray(values[::-1])
