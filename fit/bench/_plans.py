"""What a benchmark measures: all, what takes a minute, or what tests can wait for."""

from dataclasses import dataclass, replace

from ._fit_points import Limits
from ._measure import budgets
from ._peers import PEERS
from ._render_points import Choices
from ._scenes import EVERY, SIZE, THIN
from ._settings import Setting

WHOLE = SIZE[0] * SIZE[1]
"""Pixels of the paper's picture."""

ALL_SETTINGS = (
    Setting(),
    Setting("dogleg"),
    Setting("bfgs"),
    Setting(dtype="float32"),
    Setting(reduction="moments"),
    Setting(reduction="bins"),
    Setting(every=16),
)


@dataclass(frozen=True)
class Plan:
    """What is measured, and how much of it."""

    renders: tuple[str, ...]
    """Scenes that are drawn, by the names of `built_in`."""
    render_pixels: int
    """At most; larger scenes are drawn smaller."""
    choices: Choices
    looks: tuple[str, ...]
    """Of the combine step."""
    combine_pixels: int
    """At most."""
    fits: tuple[tuple[str, str, int], ...]
    """Scene and look of each fit, and pixels of its photo at most."""
    fit_pixels: int
    """Of a photo of the user's own, at most."""
    settings: tuple[Setting, ...]
    peers: tuple[str, ...]
    parts: tuple[int, ...]
    """One in so many pixels is looked at."""
    scales: tuple[int, ...]
    """Width and height of a photo are divided by."""
    limits: Limits
    whole: bool
    """Also what needs processes of its own: first fits, commands from file to file, memory."""


FULL = Plan(
    renders=("paper", "march", "EPIC", "ISS", "extreme"),
    render_pixels=WHOLE,
    choices=Choices(),
    looks=(
        "layers",
        "air",
        "air+density",
        THIN,
        f"{THIN}+sun",
        EVERY,
        "rim",
        "rim+gradient",
        "gradient",
        "gradient+table+mie+veil",
    ),
    combine_pixels=WHOLE // 16,
    fits=(
        ("synthetic", "layers", WHOLE // 4),
        ("synthetic", THIN, WHOLE // 64),
        ("march", "layers", WHOLE),
        ("march", THIN, WHOLE // 8),
        ("EPIC", "layers", WHOLE),
        ("EPIC", THIN, WHOLE),
        ("ISS", THIN, WHOLE // 16),
        ("extreme", "layers", WHOLE),
    ),
    fit_pixels=WHOLE // 16,
    settings=ALL_SETTINGS,
    peers=tuple(PEERS),
    parts=(2, 4, 16, 64, 256),
    scales=(2, 4, 8, 16),
    limits=Limits(),
    whole=True,
)

QUICK = replace(
    FULL,
    renders=("synthetic", "extreme"),
    render_pixels=WHOLE // 16,
    choices=Choices(("window16", "window24", "linear"), (1280, 20480), (2, 4)),
    looks=("layers",),
    combine_pixels=WHOLE // 16,
    fits=(("synthetic", "layers", WHOLE // 16),),
    settings=(Setting(), Setting(reduction="moments"), Setting(dtype="float32")),
    peers=("SciPy trf", "optax L-BFGS", "optimistix LM"),
    parts=(4, 16, 64),
    scales=(2, 4),
    limits=Limits(longest=0.1, most=20),
    whole=False,
)

SAMPLE = replace(
    QUICK,
    renders=("synthetic",),
    render_pixels=WHOLE // 64,
    choices=Choices(("window16", "linear"), (1280, 20480), (2,)),
    looks=("layers",),
    combine_pixels=WHOLE // 64,
    fits=(("synthetic", "layers", WHOLE // 64),),
    settings=(Setting(reduction="moments"),),
    peers=("SciPy trf",),
    parts=(4,),
    scales=(2,),
    limits=Limits(longest=60.0, most=20),
)
"""What the tests can wait for. No curve ends by the clock, which is another one elsewhere."""


def steps_of(plan: Plan, own: int) -> int:
    """About how many there will be."""
    choices = plan.choices
    of_scene = 2 * len(choices.formats) + len(choices.meshes) + len(choices.parts) + 2
    curve = 2 * len(budgets(min(plan.limits.most, 50))) // 3  # most stand still before
    curves = len(plan.settings) + len(plan.peers)
    of_fit = 2 + len(plan.parts) + len(plan.scales) + curves * curve
    scenes, fits = (own, 2 * own) if own else (len(plan.renders), len(plan.fits))
    return scenes * of_scene + 4 * len(plan.looks) + fits * of_fit + 6 * plan.whole
