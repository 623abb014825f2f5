"""Options and arguments that several commands have."""

from typing import Annotated, Literal

import typer

from render_gl._choices import DepthFormat

from .._choices import JpegHandling, LayerSource, Sampling

Depths = Literal["auto", DepthFormat]

SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help="Scene file (TOML).")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
LookOption = Annotated[
    str | None,
    typer.Option(metavar="LOOK", help="A look's name or Python file, in place of the scene's."),
]
FitLookOption = Annotated[
    str | None,
    typer.Option(
        metavar="LOOK",
        help="A look's name or Python file; auto, unless the scene names one, is air with the "
        "terms that the photo supports; layers is the paper's.",
    ),
]
AlignOption = Annotated[
    bool,
    typer.Option(
        "--align", help="Turn and zoom each scene's camera until its limb meets a photo's."
    ),
]
JpegOption = Annotated[
    JpegHandling,
    typer.Option(help="undo: correct for what JPEG did to the photo, for seconds."),
]
SamplingOption = Annotated[
    Sampling, typer.Option(help="point: the photo is a render without antialiasing.")
]
TermsOption = Annotated[
    str | None,
    typer.Option(
        metavar="A,B",
        help="What is added to the look, such as density,saturation; fit: also blur.",
    ),
]
SourceOption = Annotated[
    LayerSource,
    typer.Option(
        help="Layers by OpenGL: each pixel's own ray (raster) or the paper's meshes; or by JAX."
    ),
]
DepthOption = Annotated[
    Depths,
    typer.Option(help="Depth format of the passes; auto is the cheapest that is exact enough."),
]
