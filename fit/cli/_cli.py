"""The command line: `airlight render | fit | check | export | looks | bench | stress |
version`.

Exit codes: 0 done (and, with a warning, a fit at a bound); 1 a check or `stress` failed or the
fit has another verdict, such as a look that does not match (--accept-misfit: 0); 2 bad input, in
one line on standard error with a remedy; 70 a bug (`_guard`).

Nothing that computes is imported here: help, exports and wrong options have their answer before
JAX, which takes seconds, is asked for (`_progress.computing`).
"""

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from model_jax._choices import Encoding
from model_jax._errors import InputError, printable
from render_gl._choices import Source
from render_gl._files import check_file

from .._choices import LayerSource, LossName, SolverName, Where, check_steps
from ..report._export import Format, export_text, write_export
from ..report._fitted import read_fit
from . import _assignments as assignments
from ._bench import bench
from ._drawing import NOTHING_IN_VIEW, draw_scene, in_view, parse_size, write_png
from ._guard import command_line, devices_found, guard, tell
from ._options import (
    AlignOption,
    DepthOption,
    Depths,
    FitLookOption,
    JpegOption,
    JsonOption,
    LookOption,
    SamplingOption,
    SceneArgument,
    SourceOption,
    TermsOption,
)
from ._outputs import check_folder, prepare_folder, versions
from ._progress import computing, console, say
from ._stress import stress

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Render a planet's atmosphere as depth layers, and fit its look to photos.",
)


def main() -> None:
    """Entry point of the console script: errors in one line, no traceback for a user's mistake."""
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    with guard(command_line):
        app(standalone_mode=False)


def _print_version(asked: bool) -> bool:
    if asked:
        print(f"airlight {versions()['airlight']}")
        raise typer.Exit
    return asked


@app.callback()
def _airlight(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Say airlight's version."
        ),
    ] = False,
) -> None:
    """Render a planet's atmosphere as depth layers, and fit its look to photos."""


@app.command()
def render(
    scene: SceneArgument,
    out: Annotated[
        str, typer.Option("-o", "--out", help="OUT.exr: layers and picture; OUT.png: picture only.")
    ],
    look: LookOption = None,
    terms: TermsOption = None,
    source: SourceOption = "raster",
    depth: DepthOption = "auto",
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Another size; vertical field of view stays.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Draw a scene's layers and combined picture."""
    if not out:
        raise InputError("-o: is empty; name a file, .exr or .png")
    suffix = Path(out).suffix.lower()
    if suffix not in (".exr", ".png"):
        raise InputError(f"{out}: is neither .exr (layers and picture) nor .png (picture)")
    pixels = None if size is None else parse_size(size)
    check_file(scene)
    facts: dict[str, Any] = {"source": source}
    told: str = source
    depth_format = "linear"
    with computing() as step:
        import render_gl

        file = render_gl.load_scene(scene, assignments.look_of(look, terms))
        drawn = file.scene if pixels is None else file.scene.resized(*pixels)
        if source != "analytic":
            choice = render_gl.choose_format(drawn, depth)
            depth_format = choice.depth_format
            facts |= {"depth": depth_format, "depth_error": choice.error, "reason": choice.reason}
            told += f", {depth_format} depths: {choice.reason}"
        step("drawing")
        layers, picture = draw_scene(drawn, file.look, source, depth_format)
        step("writing")
        if suffix == ".exr":
            render_gl.write_layers(out, layers, drawn, picture, file.look)
        else:
            write_png(out, picture)
    camera = drawn.camera
    warnings = [] if in_view(layers) else [NOTHING_IN_VIEW]
    facts["warnings"] = warnings
    say(
        as_json,
        {"out": out, "width": camera.width, "height": camera.height} | facts,
        f"{printable(out)}: {camera.width}×{camera.height}, {told}",
    )
    for warning in warnings:
        tell(f"warning: {warning}")


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
    look: FitLookOption = None,
    terms: TermsOption = None,
    source: Annotated[
        LayerSource | None,
        typer.Option(help="Layers by OpenGL passes (the default), or by exact intersection."),
    ] = None,
    depth: Annotated[
        Depths | None, typer.Option(help="Depth format of the passes; linear by default.")
    ] = None,
    align: AlignOption = False,
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
        typer.Option(metavar="A,B", help="Parameters to fit, such as background,gamma.2."),
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
        LossName, typer.Option(help="Least squares, or one that doubts outliers.")
    ] = "linear",
    jpeg: JpegOption = "keep",
    sampling: SamplingOption = "area",
    where: Annotated[
        Where,
        typer.Option(help="Pixels of the ring, of ring and sky beside it, of the planet, or all."),
    ] = "all",
    solver: Annotated[SolverName, typer.Option(help="Of the descent.")] = "lm",
    max_steps: Annotated[int | None, typer.Option(help="Steps the solver may take.")] = None,
    accept_misfit: Annotated[
        bool, typer.Option("--accept-misfit", help="Exit 0 though the look does not match.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Fit a look to a photo, or one look to several photos.

    Fitted are the look's parameters (`airlight looks`). Several photos share the look, and each has
    an exposure and a black level of its own instead of the background.
    """
    assignments.check_paths(paths, layers)
    if layers is None and any(given is not None for given in (near, far, encoding)):
        raise InputError(
            "fit: --near, --far and --encoding go with --layers; a scene has its own clip planes"
        )
    if constant != 1 and encoding != "log":
        raise InputError(f"fit: --constant {constant:g} goes with --encoding log")
    if layers is not None and (source is not None or depth is not None or align):
        raise InputError("fit: --source, --depth and --align are of a scene; --layers has none")
    if layers is None and len(paths) > 2 and (mask is not None or tone_curve is not None):
        raise InputError(
            "fit: --mask and --tone-curve are of one photo; with several, write mask and "
            "tone_curve into [photo] of each one's scene"
        )
    check_steps("max-steps", max_steps)
    terms, blurs = assignments.without_blur(terms)
    asked: dict[str, Any] = dict(  # noqa: C408 (the names of `Job`'s fields)
        photos=tuple(paths if layers is not None else paths[1::2]),
        scenes=tuple(paths[::2]) if layers is None else (),
        layers=layers,
        near=near,
        far=far,
        encoding=encoding,
        constant=constant,
        look=assignments.look_of(look, terms),
        blurs=blurs,
        source=source or "raster",
        depth_format=depth or "linear",
        align=align,
        tone_curve=assignments.tone_curve(tone_curve),
        mask=mask,
        free=assignments.names(free),
        start=assignments.starts(start or ()),
        bounds=assignments.bounds(bounds or ()),
        priors=assignments.priors(prior or ()),
        tied=assignments.ties(tie or ()),
        loss=loss,
        jpeg=jpeg,
        sampling=sampling,
        where=where,
        solver=solver,
        max_steps=max_steps,
        command=shlex.join(["airlight", *sys.argv[1:]]),
    )
    check_folder(out)
    for path in (*paths, *(name for name in (layers, mask) if name is not None)):
        check_file(path)
    with computing() as step:
        from ._job import Job, run_job

        result, document = run_job(Job(**asked), out, step)
    if as_json:
        print(json.dumps(document, allow_nan=False))
    else:
        from ..report._terminal import print_fit

        print_fit(console(), document, out)
    if result.verdict == "at_bound":
        tell("warning: the best fit lies at a bound")
    elif result.verdict != "converged" and not (accept_misfit and result.verdict == "misfit"):
        raise SystemExit(1)


@app.command()
def check(
    scene: SceneArgument,
    out: Annotated[
        str | None, typer.Option("-o", "--out", metavar="DIR", help="Folder for the three EXRs.")
    ] = None,
    look: LookOption = None,
    terms: TermsOption = None,
    depth: DepthOption = "auto",
    source: Annotated[
        Source,
        typer.Option(help="Depths of each pixel's own ray, or the paper's meshes."),
    ] = "raster",
    as_json: JsonOption = False,
) -> None:
    """Hold the OpenGL picture against JAX on the same layers, and the layers against exact ones."""
    check_file(scene)
    if out is not None:
        check_folder(out)
    with computing() as step:
        import render_gl

        file = render_gl.load_scene(scene, assignments.look_of(look, terms))
        folder = prepare_folder(out if out is not None else f"{file.path.stem}-check")
        step("drawing and comparing")
        found = render_gl.check_scene(file.scene, file.look, depth, source)
        step("writing")
        for name in ("glsl", "jax", "difference"):
            air = getattr(found.parity, name)[..., :4]
            render_gl.write_picture(folder / f"{name}.exr", air, file.scene, file.look)
    if as_json:
        print(json.dumps(found.summary() | {"out": str(folder)}, allow_nan=False))
    else:
        from ..report._terminal import print_check

        print_check(console(), found.summary(), scene, str(folder))
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
    for warning in (fitted.warning, *fitted.warnings):
        if warning is not None:
            tell(f"warning: {warning}")


@app.command()
def looks(
    look: Annotated[
        str | None, typer.Option(metavar="LOOK", help="Only this one, by its name or Python file.")
    ] = None,
    fields: Annotated[
        bool, typer.Option("--fields", help="Also what a look may ask of a pixel's ray.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """List the looks: built in, installed, or in a file, with their parameters."""
    with computing(keep=False):
        from ._looks import describe_looks, looks_text

        found = describe_looks(look)
    say(as_json, found, looks_text(found, fields))


app.command()(bench)
app.command()(stress)


@app.command()
def version(
    devices: Annotated[
        bool, typer.Option("--devices", help="Also the OpenGL renderer and JAX's devices.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Versions of airlight and of what it computes with."""
    facts: dict[str, Any] = versions() | (devices_found() if devices else {})
    lines = [
        f"{name:12} {value if isinstance(value, str) else ', '.join(value)}"
        for name, value in facts.items()
    ]
    say(as_json, facts, "\n".join(lines))
