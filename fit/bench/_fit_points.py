"""What a fit costs and how far off it is: curves of settings and peers, budget by budget."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from model_jax import AirlightError

from ._measure import budgets, measure, stands_still
from ._peers import PEERS, installed
from ._point import Point, timed
from ._problems import MAX_STEPS, Case
from ._settings import Ended, Setting, run_search, run_setting, scaled


@dataclass(frozen=True)
class Limits:
    """How far curves go."""

    longest: float = 1.0
    """Seconds of one run after which a budget grows no further."""
    most: int = 1000
    """The largest budget."""


Run = Callable[[int], Ended]


def fit_points(
    case: Case,
    smaller: dict[int, Case],
    settings: tuple[Setting, ...],
    peers: tuple[str, ...],
    parts: tuple[int, ...],
    limits: Limits,
    tell: Callable[[str], None],
) -> Iterator[Point]:
    """Points of one case: the search as `fit` makes it, settings, shares of the pixels, peers.

    Args:
        smaller: the same photo with its width and height divided by the key.
    """
    tell(f"{case.scene}, {case.name}: the optimum")
    told = case.told  # found once, before anything is timed
    tell(f"{case.scene}, {case.name}: airlight")
    whole = _one(case, "airlight", "as fit() does", case.pixels, partial(run_search, case))
    if not told.free:
        yield replace(whole, note="these pixels tell nothing of this look: no curves")
        return
    yield whole
    for every in parts:
        tell(f"{case.scene}, {case.name}: 1/{every} of the pixels")
        few = scaled(case, every)
        if few.pixels > 10 * len(case.free):
            words = f"as fit() does, 1/{every} of the pixels"
            yield _one(
                case, "airlight, share of pixels", words, few.pixels, partial(run_search, few)
            )
    for part, small in smaller.items():
        tell(f"{case.scene}, {case.name}: a {part}th of the width")
        yield _one(
            case,
            "airlight, photo scale",
            f"as fit() does, 1/{part}",
            small.pixels,
            partial(run_search, small),
        )
    for setting in _possible(case, settings):
        yield from _curve(
            case,
            f"airlight {setting}",
            "steps",
            partial(run_setting, told, setting),
            replace(limits, most=min(limits.most, MAX_STEPS)),
            tell,
        )
        if setting.reduction != "tiles":
            for exact in (1, 2, 3):
                after = replace(setting, exact=exact)
                words = f"{setting}, then {exact} exact steps"
                method = f"airlight {setting}, exact steps"
                yield _one(
                    case,
                    method,
                    words,
                    case.pixels,
                    partial(run_setting, told, after, MAX_STEPS),
                )
    for name in peers:
        if installed(name):
            yield from _curve(case, name, "budget", partial(PEERS[name], told), limits, tell)


def _possible(case: Case, settings: tuple[Setting, ...]) -> list[Setting]:
    """Sums and bins stand for all pixels of some looks only."""

    def fits(setting: Setting) -> bool:
        if setting.reduction == "moments":
            return case.model.linear
        if setting.reduction == "bins":
            return len(case.columns.fields) <= 2 and case.columns.surface is None
        return True

    return [setting for setting in settings if fits(setting)]


def _one(case: Case, method: str, setting: str, pixels: int, run: Callable[[], Ended]) -> Point:
    """A point of its own."""
    point = Point("fit", case.scene, case.name, method, setting, pixels)
    try:
        ended, times = measure(run)
    except (AirlightError, ValueError, ArithmeticError) as error:
        return replace(point, status="failed", note=_line(error))
    point = replace(point, **timed(times), evaluations=ended.evaluations, bytes=ended.bytes)
    return replace(point, **case.judged(ended.vector))


def _curve(
    case: Case,
    method: str,
    unit: str,
    run: Run,
    limits: Limits,
    tell: Callable[[str], None],
) -> Iterator[Point]:
    """Points of budgets that grow until the error stands still, the solver ends, or it takes too
    long. What is judged is not timed."""
    errors: list[float] = []
    seen: list[int | None] = []
    for budget in budgets(limits.most):
        tell(f"{case.scene}, {case.name}: {method}, {budget} {unit}")
        point = _one(case, method, f"{unit} {budget}", case.pixels, partial(run, budget))
        seen.append(point.evaluations)
        if seen[-2:-1] != [point.evaluations]:  # else the same again
            yield point
        if point.parameters is None or seen[-3:] == 3 * [point.evaluations]:
            return  # it ended of itself
        errors.append(point.parameters)
        if stands_still(errors) or (point.seconds or 0.0) > limits.longest:
            return


def _line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0][:200]
