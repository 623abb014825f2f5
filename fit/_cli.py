"""The command line: `airlight render | fit | check | export | bench | version`.

Exit codes: 0 done (and, with a warning, a fit at a bound); 1 the check failed or the fit has
another verdict; 2 bad input, in one line on standard error with a remedy; 70 a bug (`_guard`).
"""

import json
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

import render_gl
from model_jax import AirlightError, Encoding, InputError, Layers, Look, Scene, Srgb, composite
from model_jax._errors import printable

from . import _assignments as assignments
from ._compile import float64
from ._compression import JpegHandling
from ._export import Format, export_text, read_fit, write_export
from ._guard import check_devices, guard, tell
from ._job import Job, Source, make_layers, prepare_folder, run_job, versions
from ._pixels import Sampling
from ._terminal import print_bench, print_check, print_fit

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Render a planet's atmosphere as depth layers, and fit its look to photos.",
)


Depths = Literal["auto", render_gl.DepthFormat]

SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help="Scene file (TOML).")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
SourceOption = Annotated[
    Source,
    typer.Option(
        help="Layers by OpenGL: each pixel's own ray (raster) or the paper's meshes; or by JAX."
    ),
]
DepthOption = Annotated[
    Depths,
    typer.Option(help="Depth format of the passes; auto is the cheapest that is exact enough."),
]


def main() -> None:
    """Entry point of the console script: errors in one line, no traceback for a user's mistake."""
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    with guard(_command), float64():
        app(standalone_mode=False)


@app.command()
def render(
    scene: SceneArgument,
    out: Annotated[
        str, typer.Option("-o", "--out", help="OUT.exr: layers and picture; OUT.png: picture only.")
    ],
    source: SourceOption = "raster",
    depth: DepthOption = "auto",
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Another size; vertical field of view stays.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Draw a scene's layers and combined picture."""
    check_devices()
    if not out:
        raise InputError("-o: is empty; name a file, .exr or .png")
    suffix = Path(out).suffix.lower()
    if suffix not in (".exr", ".png"):
        raise InputError(f"{out}: is neither .exr (layers and picture) nor .png (picture)")
    file = render_gl.load_scene(scene)
    drawn = file.scene if size is None else _resized(file.scene, size)
    facts: dict[str, Any] = {"source": source}
    told: str = source
    depth_format = "linear"
    if source != "analytic":
        choice = render_gl.choose_format(drawn, depth)
        depth_format = choice.depth_format
        facts |= {"depth": depth_format, "depth_error": choice.error, "reason": choice.reason}
        told += f", {depth_format} depths: {choice.reason}"
    with _steps() as step:
        step("drawing")
        layers = make_layers(drawn, source, depth_format)
        picture = _picture(drawn, layers, file.look, source, depth_format)
        step("writing")
        if suffix == ".exr":
            render_gl.write_layers(out, layers, drawn, picture)
        else:
            _write_png(out, picture)
    camera = drawn.camera
    _say(
        as_json,
        {"out": out, "width": camera.width, "height": camera.height} | facts,
        f"{printable(out)}: {camera.width}×{camera.height}, {told}",
    )


@app.command()
def fit(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="SCENE PHOTO ...",
            help="Scene file and photo, once or for several photos; PHOTO alone with --layers.",
        ),
    ],
    out: Annotated[str, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")],
    layers: Annotated[
        str | None, typer.Option(metavar="LAYERS.exr", help="Layers of another renderer.")
    ] = None,
    near: Annotated[
        float | None, typer.Option(help="With --layers: near plane of coded depths.")
    ] = None,
    far: Annotated[
        float | None, typer.Option(help="With --layers: far plane of coded depths, or inf.")
    ] = None,
    encoding: Annotated[
        Encoding | None,
        typer.Option(help="With --layers: how its depths are coded, if its header does not say."),
    ] = None,
    constant: Annotated[
        float, typer.Option(help="With log depths: C of log(C z + 1) / log(C far + 1).")
    ] = 1.0,
    source: Annotated[
        Source | None,
        typer.Option(help="Layers by OpenGL passes (the default), or by exact intersection."),
    ] = None,
    depth: Annotated[
        Depths | None, typer.Option(help="Depth format of the passes; linear by default.")
    ] = None,
    tone_curve: Annotated[
        str | None,
        typer.Option(help="linear, srgb or EXPOSURE,GAMMA of 1-exp(-EXPOSURE x); one photo only."),
    ] = None,
    mask: Annotated[
        str | None,
        typer.Option(help="Picture of the photo's size; white = use the pixel; one photo only."),
    ] = None,
    free: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Parameters to fit, such as brightness,gamma.2."),
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Start value, also of what is held; repeatable."),
    ] = None,
    bounds: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW:HIGH", help="Allowed range; an end may be left out."),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=MEAN:SIGMA", help="What is known before the photo."),
    ] = None,
    tie: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=OTHER", help="Two parameters that shall be equal."),
    ] = None,
    loss: Annotated[
        str, typer.Option(help="linear, or to doubt outliers: huber, soft_l1, cauchy.")
    ] = "linear",
    jpeg: Annotated[
        JpegHandling,
        typer.Option(help="undo: correct for what JPEG did to the photo, for seconds."),
    ] = "keep",
    sampling: Annotated[
        Sampling,
        typer.Option(help="point: the photo is a render without antialiasing."),
    ] = "area",
    solver: Annotated[
        str, typer.Option(help="lm, dogleg, gauss_newton, bfgs, lbfgs or nelder_mead.")
    ] = "lm",
    max_steps: Annotated[int | None, typer.Option(help="Steps the solver may take.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a look to a photo, or one look to several photos.

    The look is brightness, shadow weight, tint and background. Several photos share it, and each
    has an exposure and a black level of its own instead of the background.
    """
    check_devices()
    _check_paths(paths, layers)
    if layers is None and any(given is not None for given in (near, far, encoding)):
        raise InputError(
            "fit: --near, --far and --encoding go with --layers; a scene has its own clip planes"
        )
    if constant != 1 and encoding != "log":
        raise InputError(f"fit: --constant {constant:g} goes with --encoding log")
    if layers is not None and (source is not None or depth is not None):
        raise InputError("fit: --source and --depth draw a scene's layers; --layers has its own")
    job = Job(
        photos=tuple(paths if layers is not None else paths[1::2]),
        scenes=tuple(paths[::2]) if layers is None else (),
        layers=layers,
        near=near,
        far=far,
        encoding=encoding,
        constant=constant,
        source=source or "raster",
        depth_format=depth or "linear",
        tone_curve=_tone_curve(tone_curve),
        mask=mask,
        free=assignments.names(free),
        start=assignments.starts(start or ()),
        bounds=assignments.bounds(bounds or ()),
        priors=assignments.priors(prior or ()),
        tied=assignments.ties(tie or ()),
        loss=loss,
        jpeg=jpeg,
        sampling=sampling,
        solver=solver,
        max_steps=max_steps,
        command=shlex.join(["airlight", *sys.argv[1:]]),
    )
    with _steps() as step:
        result, document = run_job(job, out, step)
    if as_json:
        print(json.dumps(document, allow_nan=False))
    else:
        print_fit(Console(), document, out)
    if result.verdict == "at_bound":
        tell("warning: the best fit lies at a bound")
    elif result.verdict != "converged":
        raise SystemExit(1)


@app.command()
def check(
    scene: SceneArgument,
    out: Annotated[
        str | None, typer.Option("-o", "--out", metavar="DIR", help="Folder for the three EXRs.")
    ] = None,
    depth: DepthOption = "auto",
    source: Annotated[
        render_gl.Source,
        typer.Option(help="Depths of each pixel's own ray, or the paper's meshes."),
    ] = "raster",
    as_json: JsonOption = False,
) -> None:
    """Hold the OpenGL picture against JAX on the same layers, and the layers against exact ones."""
    check_devices()
    file = render_gl.load_scene(scene)
    folder = prepare_folder(out if out is not None else f"{file.path.stem}-check")
    with _steps() as step:
        step("drawing and comparing")
        found = render_gl.check_scene(file.scene, file.look, depth, source)
        step("writing")
        for name, picture in (
            ("glsl", found.parity.glsl),
            ("jax", found.parity.jax),
            ("difference", found.parity.difference),
        ):
            render_gl.write_picture(folder / f"{name}.exr", picture, file.scene)
    if as_json:
        print(json.dumps(found.summary() | {"out": str(folder)}, allow_nan=False))
    else:
        print_check(Console(), found.summary(), scene, str(folder))
    if not found.passed:
        raise SystemExit(1)


@app.command()
def export(
    fit_json: Annotated[str, typer.Argument(metavar="FIT.json", help="What a fit wrote.")],
    to: Annotated[
        Format,
        typer.Option(help="Shader constants or uniforms, flat JSON, a scene's [look], or a table."),
    ],
    out: Annotated[
        str | None, typer.Option("-o", "--out", metavar="FILE", help="Instead of standard output.")
    ] = None,
) -> None:
    """Write a fit's numbers for a shader, a scene file or a program."""
    fitted = read_fit(fit_json)
    if out is None:
        print(export_text(fitted, to), end="")
    else:
        write_export(out, fitted, to)
    if fitted.warning is not None:
        tell(f"warning: {fitted.warning}")


@app.command()
def bench(
    out: Annotated[str, typer.Option("-o", "--out", metavar="DIR", help="Folder for the tables.")],
    quick: Annotated[bool, typer.Option(help="A sixteenth of the pixels; no large photo.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure how fast a fit is, beside SciPy and optimistix, on this machine."""
    check_devices()
    from ._bench import run_bench  # its peer, SciPy, is an extra

    with _steps() as step:
        document = run_bench(out, quick, step)
    if as_json:
        print(json.dumps(document, allow_nan=False))
    else:
        print_bench(Console(), document, out)


@app.command()
def version(as_json: JsonOption = False) -> None:
    """Versions, OpenGL renderer and JAX devices."""
    try:
        renderer = render_gl.renderer_name()
    except AirlightError as error:
        renderer = f"none ({error})"
    try:
        check_devices()
        devices = [str(device) for device in jax.devices()]
    except AirlightError as error:
        devices = [f"none ({error})"]
    facts: dict[str, Any] = versions() | {"OpenGL": renderer, "JAX devices": devices}
    lines = [f"{name:12} {value}" for name, value in facts.items() if isinstance(value, str)]
    _say(
        as_json, facts, "\n".join([*lines, f"{'JAX devices':12} {', '.join(facts['JAX devices'])}"])
    )


def _command() -> str:
    """The command line as far as its subcommand, if it has one."""
    commands = ("render", "fit", "check", "export", "bench", "version")
    return " ".join(["airlight", *(word for word in sys.argv[1:2] if word in commands)])


def _check_paths(paths: list[str], layers: str | None) -> None:
    """SCENE PHOTO pairs, or one PHOTO for layers."""
    if layers is not None and len(paths) != 1:
        raise InputError(
            f"fit: got {len(paths)} paths with --layers; give --layers LAYERS.exr PHOTO"
        )
    if layers is None and (len(paths) % 2 or not paths):
        raise InputError(
            f"fit: got {len(paths)} paths; give SCENE PHOTO, for several photos "
            "SCENE1 PHOTO1 SCENE2 PHOTO2, or --layers LAYERS.exr PHOTO"
        )


def _picture(scene: Scene, layers: Layers, look: Look, source: Source, depth_format: str) -> Any:
    """The picture by the source's own combine: JAX's for analytic, else the shader's."""
    if source == "analytic":
        return composite(layers, look)
    return render_gl.render_image(scene, look, depth_format, source)


def _resized(scene: Scene, size: str) -> Scene:
    width, cross, height = size.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise InputError(f"--size {size}: must be WIDTHxHEIGHT in pixels, such as 640x480")
    camera = scene.camera.resized(int(width), int(height))
    return Scene(camera, scene.planet, scene.atmosphere, scene.sun, scene.occluders)


def _write_png(out: str, picture: Any) -> None:
    import numpy as np
    from PIL import Image

    stored = np.clip(Srgb().encode(np.asarray(picture, np.float64)[..., :3]), 0.0, 1.0)
    image = Image.fromarray(np.round(stored * 255).astype(np.uint8))
    render_gl.write_whole(out, lambda path: image.save(path, format="PNG"))


def _tone_curve(text: str | None) -> Any:
    """The option's text in the form that scene files use."""
    if text is None or "," not in text:
        return text
    try:
        exposure, gamma = (float(number) for number in text.split(","))
    except ValueError:
        raise InputError(f"--tone-curve {text}: must be linear, srgb or EXPOSURE,GAMMA") from None
    return {"exposure": exposure, "gamma": gamma}


@contextmanager
def _steps() -> Iterator[Any]:
    """A progress line on standard error that names the step; gone when done."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    console = Console(stderr=True)
    quiet = not console.is_terminal  # a pipe or a log would get stray blank lines
    with Progress(*columns, console=console, transient=True, disable=quiet) as progress:
        task = progress.add_task("starting", total=None)
        yield lambda text: progress.update(task, description=text)


def _say(as_json: bool, facts: dict[str, Any], text: str) -> None:
    print(json.dumps(facts) if as_json else text)
