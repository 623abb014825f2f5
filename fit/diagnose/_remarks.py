"""What a fit says beside its numbers: what it left out, why there is no air, what to beware of."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from model_jax import FIELDS
from model_jax._fields import amount_of

from .._choices import CHANNELS
from .._result import FitResult, LeftOut
from .._verdict import STRUCTURED_PX, WELL_EXPLAINED
from ..photo._columns import Columns, light_at
from ..photo._photo import Photo
from ..photo._pixels import UNKNOWN_SURFACE, Pixels
from ..solve._parameters import FitParameter, free_directions
from ..solve._task import Task
from ._alignment import misaligned
from ._evidence import CHUNK
from ._patterns import CAUSES

_NO_RING = {"no air", UNKNOWN_SURFACE, "in front of space"}
"""Reasons of all pixels where none with air in front of space is asked for and there."""


def pixel_remarks(pixels: Sequence[Pixels]) -> list[LeftOut]:
    """What could not be taken into account of the pixels used."""
    return [
        LeftOut(f"{what}, photo {number}" if len(pixels) > 1 else what, why)
        for number, px in enumerate(pixels, 1)
        for what, why in px.remarks
    ]


def leave_out(
    task: Task, columns: Sequence[Columns]
) -> tuple[tuple[FitParameter, ...], list[LeftOut]]:
    """What can be fitted at all: nothing of a field that is not there, no colour without any."""
    asked = [p for p in task.parameters if p.role == "free"]
    left_out: list[LeftOut] = []
    for family in dict.fromkeys(p.family for p in asked if p.needs is not None):
        why = _why_without_field(task, columns, asked, family)
        if why is not None:
            asked = [p for p in asked if p.family != family]
            left_out.append(LeftOut(family, why))
    fact = type(task.look).SEPARABLE
    for k, channel in enumerate(CHANNELS):
        if fact is not None and all(c.color[k] == 0 for c in columns):
            colourless = {f"{name}.{channel}" for name in (fact.factors, fact.weight)}
            why = f"the air's color is 0 in channel {channel}"
            left_out += [LeftOut(p.name, why) for p in asked if p.name in colourless]
            asked = [p for p in asked if p.name not in colourless]
    factors = [p for p in asked if p.mean_one]
    if factors and columns and all(len(c.copies) == 2 for c in columns):
        named = [p.name for p in factors] if len(factors) < 3 else [factors[0].family]
        left_out += [LeftOut(name, "a grey photo does not tell colours") for name in named]
        asked = [p for p in asked if p not in factors]
        factors = []
    if factors and not free_directions(factors, task.parameters)[0].shape[1]:
        only = factors[0]
        left_out.append(LeftOut(only.name, f"the mean of {only.family} fixes the only free one"))
        asked.remove(only)
    return tuple(asked), left_out


def _why_without_field(
    task: Task, columns: Sequence[Columns], asked: Sequence[FitParameter], family: str
) -> str | None:
    """Why a parameter of a field has no effect, or none of its own; None where it has."""
    about = type(task.look).PARAMETERS[family]
    assert about.of is not None
    if family == type(task.look).GROUND:
        return _why_no_ground(task, columns)
    field = FIELDS[about.of]
    if field.of_shadow and field.absent and not any(la.has_shadow for la in task.layers):
        return field.absent
    if not any(len(c.index) for c in columns):
        return None
    if not _shows(columns, about.of):
        return field.unseen or f"{about.of} is 0 in all pixels used"
    fact = type(task.look).SEPARABLE
    if fact is None or _shows(columns, fact.first):
        return None
    if not any(p.family == fact.amplitude for p in asked):
        return None
    unseen = FIELDS[fact.first].unseen
    return f"{unseen}, so only {fact.amplitude} × {family} is told; {family} is held"


def _why_no_ground(task: Task, columns: Sequence[Columns]) -> str | None:
    """Why a factor on the light of what lies behind the air has no effect; None where it has."""
    if any(c.surface is not None and c.stencil is None for c in columns):
        return None
    if task.blurs:
        return "with a blur the planet's light is the photo's own"
    if all(la.surface is None for la in task.layers):
        return (
            "the layers do not tell the light of the planet; give it an albedo, [1, 1, 1] if "
            "nobody knows it"
        )
    return "behind no pixel used is lit ground"


def _shows(columns: Sequence[Columns], name: str) -> bool:
    """Some pixel, or a line that it sees, has more of a field than its rounding."""
    return any(
        name in fields and (np.abs(amount_of(fields, name)) > c.width_error).any()
        for c in columns
        for fields in ([c.fields] if c.stencil is None else [c.stencil.fields, c.stencil.inner])
    )


def why_no_data(
    task: Task,
    pixels: Sequence[Pixels],
    columns: Sequence[Columns],
    asked: tuple[FitParameter, ...],
) -> str | None:
    """Why there is nothing to fit, or None."""
    for number, (photo, px, c) in enumerate(zip(task.photos, pixels, columns, strict=True)):
        which = f"photo {number + 1}: " if len(columns) > 1 else ""
        if not px.count:
            counts = ", ".join(f"{count} {reason}" for reason, count in px.excluded.items())
            return f"{which}no pixel can be used ({counts}){_remedy(px)}"
        measured = np.ones_like(c.light, bool) if c.clipped is None else c.clipped == 0
        if c.clipped is not None and not measured.any():
            what = "saturated" if (c.clipped > 0).any() else "black"
            return f"{which}the photo is {what} where the air is"
        if not light_at(photo, c.index).any():
            return f"{which}the photo is black where the air is"
        light = np.where(measured, c.light, np.nan)
        constant = not (np.nanmax(light, axis=0) > np.nanmin(light, axis=0)).any()
        if constant and c.clipped is None and _varies(c):
            return f"{which}the photo is the same in all pixels used, the air is not"
    need = free_directions(asked, task.parameters)[0].shape[1] + 1
    count = sum(px.count for px in pixels)
    if count < need:
        return f"the number of pixels that can be used is {count}, needed are {need}"
    measured = sum(
        3 * len(c.index) if c.clipped is None else int((c.clipped == 0).sum()) for c in columns
    )
    if measured < 3 * need:
        return (
            f"the number of samples that are neither black nor white is {measured}, needed are "
            f"{3 * need}"
        )
    return None


def _remedy(pixels: Pixels) -> str:
    """What to do where all air lies in front of a planet of which nothing is known."""
    if UNKNOWN_SURFACE not in pixels.excluded or not pixels.excluded.keys() <= _NO_RING:
        return ""
    return (
        ": all air lies in front of a planet whose light is not known; give the planet one colour, "
        "[planet] albedo = [0, 0, 0] for a dark one, [1, 1, 1] and a look with ground for any"
    )


def _varies(columns: Columns) -> bool:
    """The air's width is not the same everywhere."""
    return any(float(np.ptp(f)) > 2 * columns.width_error for f in columns.fields.values())


def file_remarks(task: Task) -> list[str]:
    """What the photos' files say that was not followed."""
    several = len(task.photos) > 1
    return [
        f"Photo {number}: {remark}" if several else remark
        for number, photo in enumerate(task.photos, 1)
        for remark in (photo.remarks if isinstance(photo, Photo) else ())
    ]


def warnings_of(
    result: FitResult, task: Task, residuals: Sequence[Float[np.ndarray, "_ 3"]]
) -> list[str]:
    found = []
    explained, errors = result.explained, result.errors
    identified = [result.parameters[name] for name in result.correlation_names]
    debiased = bool(identified) and all(e.compression_shift is not None for e in identified)
    if explained is not None and explained < WELL_EXPLAINED:
        found.append(
            "Look at what is left over: where it has structure, this look cannot follow the photo."
        )
    found += _misfit_warnings(result)
    for number, photo in enumerate(result.photos, 1):
        if off := misaligned(photo.alignment):
            which = f"of photo {number} " if len(result.photos) > 1 else ""
            found.append(
                f"The scene {which}is misaligned: {off}. Turn camera.forward and change "
                "camera.fov_y_deg so that they meet."
            )
    found += file_remarks(task)
    seen = debiased or result.misfits or (explained or 0) >= 1 - 1e-6
    if errors is not None and errors.correlation_px > STRUCTURED_PX and not seen:
        remedy = ""
        if task.loss == "linear" and _sticks_out(residuals):
            remedy = (
                ", and a part of the pixels sticks out: mask what shows something else than air, "
                "or use a robust loss"
            )
        elif (explained or 0) >= WELL_EXPLAINED:  # else that was said above
            remedy = ": look at where it lies in the residual picture"
        found.append(
            f"What is left over hangs together over {errors.correlation_px:.0f} pixels, which is "
            f"no noise{remedy}."
        )
    fact = type(task.look).SEPARABLE
    if any(photo.mix is not None for photo in result.photos):
        found.append(
            "The photo is grey: copies of a channel count once, and the look is compared by its "
            "luminance (ITU-R BT.709). What other weights would change is in "
            + (f"{fact.amplitude}'s interval." if fact is not None else "no interval.")
        )
    found += _value_warnings(result, task.parameters)
    if identified and task.blurs:
        found.append(
            "The planet's light is carried on to its limb from inside, and light from lines across "
            "it: near the limb that is wrong by a percent or two, which the intervals do not hold."
        )
    lossy = any(isinstance(p, Photo) and p.lossy for p in task.photos)
    if lossy and identified and not debiased:
        asked = task.jpeg == "undo"
        found.append(
            "The photo's compression rounds colours block by block, which the intervals know only "
            "in part: fit the picture before it was compressed, if there is one"
            + ("." if asked else ", or let its JPEG be undone (--jpeg undo).")
        )
    return found


def _value_warnings(result: FitResult, parameters: Sequence[FitParameter]) -> list[str]:
    """What is said of values: negative, at a bound's edge, or moved by the layers' own errors."""
    found = []
    negative = [n for n, e in result.parameters.items() if e.stderr and e.value + 3 * e.stderr < 0]
    if any(name.startswith("background") for name in negative):
        found.append("The background came out negative: the model takes light away.")
    ends = ((p, result.parameters[p.name]) for p in parameters)
    zero = [p.name for p, e in ends if e.role == "at_bound" and e.value == p.least > p.lower]
    if zero:
        found.append(
            f"Held at 0, for the best fit would take light away there: {', '.join(zero)}. Air that "
            "thins out otherwise than this look's, or the photo's tone curve, looks like that."
        )
    if levels := [name for name in negative if name.startswith("black_level")]:
        found.append(
            f"Negative by more than three standard errors: {', '.join(levels)}. The model takes "
            "light away there: check the photo's tone curve, or hold its black level."
        )
    beside = [f"{n} is {e.one_sided}" for n, e in result.parameters.items() if e.one_sided]
    if beside:
        found.append(
            f"Within its own error of a bound, so told on one side only: {', '.join(beside)}."
        )
    drawn = {
        name: (e.layer_error, max(e.interval[1] - e.value, e.value - e.interval[0]))
        for name, e in result.parameters.items()
        if e.layer_error is not None and e.interval is not None
    }
    coarse = {name: shift for name, (shift, reach) in drawn.items() if shift > reach}
    if coarse:
        shifts = ", ".join(f"{name} {shift:.2g}" for name, shift in coarse.items())
        found.append(
            f"The layers hold a mesh, whose error can shift values by more than their intervals "
            f"say ({shifts}): use more planet.triangles, no relief, or --source raster."
        )
    return found


def _sticks_out(residuals: Sequence[Float[np.ndarray, "_ 3"]]) -> bool:
    """The root mean square is over one and a half times what the median tells of normal residuals:
    some stick out that a mask or a robust loss can take away. Of a wave it is 0.67 times."""
    some = np.concatenate([r[:: max(1, len(r) // CHUNK)] for r in residuals])  # evenly chosen
    sizes = np.abs(some[np.isfinite(some)].astype(np.float64))
    return bool(np.sqrt(np.mean(sizes**2)) > 1.5 * 1.4826 * np.median(sizes))


def _misfit_warnings(result: FitResult) -> list[str]:
    """One sentence for each photo in which a cause shows."""
    found = []
    for number in range(len(result.photos)):
        causes = [misfit for misfit in result.misfits if misfit.photo == number]
        if not causes:
            continue
        which = f" of photo {number + 1}" if len(result.photos) > 1 else ""
        also = ", ".join(misfit.cause for misfit in causes[1:])
        like = " or ".join(CAUSES[name][0] for name in (causes[0].cause, *causes[0].rivals))
        found.append(
            f"The light left over{which} is not noise alone: {percent(causes[0].share)} of it "
            f"goes with {like}"
            + (f"; less plainly with: {also}" if also else "")
            + ". Intervals are widened by what that may have moved."
        )
    return found


def percent(share: float) -> str:
    """With as many nines as it takes, and never rounded up to 100 %."""
    return f"{np.floor(share * 1e4) / 1e2:.4g} %" if share > 0 else "none"
