"""The numbers that a rebuilding must not change: eight fits and four renders, as they are today.

    python -m tests.golden            compare with golden.json, every number bit for bit
    python -m tests.golden --near     after a mend: the same words, values and costs
    python -m tests.golden --write    make golden.json; only for a change on purpose, in a commit
                                      of its own that says why

Bit for bit holds on one machine, before and after a commit that only moves code. `pytest` compares
within what another processor's rounding may change (`differences`).
"""

import argparse
import hashlib
import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from PIL import Image

from fit import FitResult, fit, load_photo
from fit.cli._job import Job, run_job
from model_jax import Layers, LayersLook, Look, Occluder, Response, Scene, Srgb, record
from render_gl import check_scene, load_scene, render, render_image
from render_gl._choices import Source

from .data import FOLDER, REPOSITORY
from .fit.looks import START, TRUTH, exact_layers, picture, scene
from .model_jax.scenes import scene_of

EXAMPLES = REPOSITORY / "examples"
GOLDEN = Path(__file__).with_name("golden.json")

EPIC = Path("epic", "epic_1b_20220110005515.jpg")
ISS = Path("iss", "iss_d4_56mm.jpg")

Document = dict[str, Any]

VALUE = 1e-3
"""Of a standard error: descents end within it of the optimum (`CHECK`), wherever they come from."""
COST = 1e-10
"""Relative, of float64 sums of up to 1e7 squares: 1e7 × 2^-53 if all errors went one way."""
COST_OF_PHOTO = 1e-5
"""Relative, where another processor makes the layers in float32: an error of 2^-23 of the light of
each sample, twice, over residuals of 0.02 and more, if all went one way."""
FIGURE = 1e-2
"""Relative, of what describes a fit or a picture in a few digits: errors, correlations, means. They
serve the bit-for-bit comparison; here they only catch what is plainly another thing."""


# --- fits ---------------------------------------------------------------------------------------


def noise(shape: tuple[int, ...], size: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=size, size=shape)


def shot(layers: Layers, look: Look, response: Response | None = None, seed: int = 0) -> np.ndarray:
    """A noisy photo of a look."""
    with jax.enable_x64(True):
        clean = np.asarray(record(picture(layers, look), response or Response()))
    return clean + noise(clean.shape, 0.02, seed)


def paper() -> Document:
    file = load_scene(EXAMPLES / "paper.toml")
    layers = exact_layers(file.scene.resized(320, 256))
    return told(fit(shot(layers, file.look), layers, START))


def two_photos() -> Document:
    layers = exact_layers(scene()), exact_layers(scene().resized(120, 96))
    responses = Response(1.0, black_level=0.01), Response(2.5, black_level=-0.02)
    looks = [LayersLook(3.0, 0.2, (0.8, 0.9, 1.3))] * 2
    photos = [
        shot(*one, seed=k) for k, one in enumerate(zip(layers, looks, responses, strict=True))
    ]
    return told(fit(photos, layers, START))


def robust() -> Document:
    """A PNG with bright outliers, and white where the air is brightest."""
    layers = exact_layers(scene())
    light = shot(layers, LayersLook(4.0, 0.3, (0.8, 0.9, 1.3), background=0.05))
    light[np.random.default_rng(1).random(light.shape[:2]) < 0.03] += 0.5
    codes = np.round(255 * np.clip(np.asarray(Srgb().encode(light)), 0, 1)).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        Image.fromarray(codes).save(Path(folder, "photo.png"))
        photo = load_photo(Path(folder, "photo.png"))
    return told(fit(photo, layers, START, loss="cauchy"))


def gamma() -> Document:
    layers = exact_layers(scene())
    free = ("brightness", "shadow", "tint", "gamma", "black_level")
    response = Response(gamma=1.2, black_level=0.02)
    return told(fit(shot(layers, LayersLook(1.5, 0.3), response), layers, START, free=free))


def vmap() -> Document:
    layers = exact_layers(scene())
    photos = [shot(layers, TRUTH, seed=seed) for seed in range(3)]
    with jax.enable_x64(True):
        many = jax.jit(jax.vmap(lambda photo: fit(photo, layers, START)))(np.stack(photos))
    look = many.look
    values = {"brightness": look.brightness, "shadow": look.shadow, "background": look.background}
    values |= {f"tint.{c}": look.tint[k] for k, c in enumerate("rgb")}
    errors = np.sqrt(np.diagonal(many.covariance, axis1=1, axis2=2)).T
    return {
        "verdict": many.verdict.tolist(),
        "history": many.square_sum.tolist(),
        "parameters": {
            f"{name} {k}": {"value": float(values[name][k]), "stderr": float(stderr[k])}
            for name, stderr in zip(many.names, errors, strict=True)
            for k in range(3)
        },
    }


def job(scene: str, photo: Path, jpeg: str = "keep") -> Document:
    """The whole way from files to files, with the layers that a user gets."""
    with tempfile.TemporaryDirectory() as folder:
        files = (str(photo),), (str(EXAMPLES / scene),)
        asked = Job(*files, look="layers", source="analytic", jpeg=jpeg)
        result, document = run_job(asked, folder)
        pictures = {path.name: digest(path.read_bytes()) for path in Path(folder).glob("i*.exr")}
    named = ("color", "planet_radius", "atmosphere_height", "atmosphere_path", "tone_curve")
    return told(result) | {key: document[key] for key in named} | {"exact": pictures}


def told(result: FitResult) -> Document:
    """What a fit says, but for how long it took."""
    document = result.to_dict()
    del document["seconds"]
    return document


# --- renders ------------------------------------------------------------------------------------


def drawn(scene: Scene, depth: str = "auto", source: Source = "raster") -> Document:
    """A scene's picture and layers: counts and means of each, and what tells any bit's change."""
    look = LayersLook()
    found = check_scene(scene, look, depth, source).summary()
    layers = render(scene, depth, source)
    arrays = {
        name: np.asarray(value)
        for name, value in vars(layers).items()
        if name != "reference" and value is not None and np.ndim(value) >= 2
    } | {"picture": render_image(scene, look, depth, source)}
    return {
        "check": {key: found[key] for key in ("passed", "depth", "depth_reason")},
        "mean": {name: float(np.mean(a, dtype=np.float64)) for name, a in arrays.items()},
        "exact": {name: digest(np.ascontiguousarray(a)) for name, a in arrays.items()}
        | {"check": found},
    }


def digest(data: bytes | np.ndarray) -> str:
    return hashlib.sha256(data if isinstance(data, bytes) else data.tobytes()).hexdigest()


def relief() -> Document:
    return drawn(load_scene(EXAMPLES / "paper.toml").scene.resized(320, 256))


def meshes() -> Document:
    return drawn(load_scene(EXAMPLES / "reference.toml").scene.resized(240, 180), source="mesh")


def moons() -> Document:
    occluders = Occluder((0.4, -1.9, 0.5), 0.1), Occluder((1.6, -0.7, 0.4), 0.2)
    return drawn(eqx.tree_at(lambda s: s.occluders, scene(), occluders), "window24")


def in_the_shell() -> Document:
    """The camera within the air, widths along the rays, reversed depths."""
    inside = scene_of(
        (0.0, -1.05, 0.02), (0.8, 0.4, 0.5), fov=75.0, size=(160, 120), path="distance"
    )
    return drawn(inside, "reversed32f")


# --- the net ------------------------------------------------------------------------------------

CASES: dict[str, Callable[[], Document]] = {
    "fit paper": paper,
    "fit reference": lambda: job("reference.toml", EXAMPLES / "reference.png"),
    "fit two photos": two_photos,
    "fit robust, clipped": robust,
    "fit gamma": gamma,
    "fit vmap": vmap,
    "render relief": relief,
    "render meshes": meshes,
    "render moons": moons,
    "render in the shell": in_the_shell,
}
PHOTOS: dict[str, Callable[[Path], Document]] = {
    "fit epic": lambda data: job("epic.toml", data / EPIC, jpeg="undo"),
    "fit iss": lambda data: job("iss.toml", data / ISS),
}
"""Of photos that are too large for the repository."""


def differences(made: object, golden: object, cost: float | None, *path: str) -> Iterator[str]:
    """What is not as it was, one line each: bit for bit without `cost`, else but for rounding.

    `cost`: relative tolerance of square sums.
    """
    where, exact = ".".join(path), cost is None
    if isinstance(made, dict) and isinstance(golden, dict):
        for key in made.keys() ^ golden.keys():
            yield f"{where}.{key}: only {'now' if key in made else 'before'}"
        for key in golden.keys() & made.keys():
            if key == "parameters" and not exact:
                yield from _parameters(made[key], golden[key], cost, where)
            elif exact or key != "exact":
                yield from differences(made[key], golden[key], cost, *path, key)
    elif isinstance(made, list) and isinstance(golden, list) and not exact and "history" in path:
        # Steps on the way may differ in number; where it ends may not.
        assert cost is not None
        if made and not math.isclose(made[-1], golden[-1], rel_tol=cost):
            yield f"{where}: ends at {made[-1]!r}, was {golden[-1]!r}"
    elif isinstance(made, list) and isinstance(golden, list):
        if len(made) != len(golden):
            yield f"{where}: {made!r}, was {golden!r}"
        for k, (one, other) in enumerate(zip(made, golden, strict=False)):
            yield from differences(one, other, cost, *path, str(k))
    elif isinstance(made, float) and isinstance(golden, float) and not exact:
        if not math.isclose(made, golden, rel_tol=FIGURE, abs_tol=1e-6):
            yield f"{where}: {made!r}, was {golden!r}"
    elif made != golden:
        yield f"{where}: {made!r}, was {golden!r}"


def _parameters(made: Document, golden: Document, cost: float | None, where: str) -> Iterator[str]:
    """Values and intervals in standard errors, and what else is said of them."""
    if list(made) != list(golden):
        yield f"{where}.parameters: {list(made)}, were {list(golden)}"
    for name in made.keys() & golden.keys():
        one, other = dict(made[name]), dict(golden[name])
        stderr = other["stderr"]
        if stderr:
            pairs = [(one.pop("value"), other.pop("value"))]
            for low, high in zip(
                one.pop("interval", None) or (), other.pop("interval", None) or (), strict=True
            ):
                pairs.append((low, high))
            for now, was in pairs:
                if abs(now - was) > VALUE * stderr:
                    yield f"{where}.parameters.{name}: {now!r}, was {was!r} ± {stderr!r}"
        yield from differences(one, other, cost, where, "parameters", name)


def make(name: str) -> Document:
    """One case, by name, as JSON reads it."""
    document = CASES[name]() if name in CASES else PHOTOS[name](FOLDER)
    return json.loads(json.dumps(document, allow_nan=False))


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--write", action="store_true", help="make golden.json anew")
    words.add_argument("--near", action="store_true", help="allow for rounding")
    asked = words.parse_args()
    names = [*CASES, *(PHOTOS if FOLDER.is_dir() else ())]
    made = {}
    for name in names:
        print(name, file=sys.stderr)
        made[name] = make(name)
    if asked.write:
        if len(names) < len(CASES | PHOTOS):
            sys.exit("golden.json holds all cases: set AIRLIGHT_DATA to the photos' folder")
        GOLDEN.write_text(json.dumps(made, indent=1) + "\n")
        return
    golden = json.loads(GOLDEN.read_text())
    cost = COST if asked.near else None
    found = [line for n in names for line in differences(made[n], golden[n], cost, n)]
    how = "but for rounding" if asked.near else "to the bit"
    print("\n".join(found) or f"{len(names)} of {len(golden)} cases are as they were, {how}")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
