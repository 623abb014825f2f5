"""How numbers, shares and tone curves are written, in the terminal, on pages and in errors."""

import math
from collections.abc import Mapping

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def measured(value: float | None, stderr: float | None) -> str:
    """`value ± stderr` with two significant digits of the error: `3.0012 ± 0.0034`."""
    if value is None or not math.isfinite(value):
        return "—"
    if stderr is None or not math.isfinite(stderr) or stderr <= 0:
        return number(value)
    decimals = 1 - math.floor(math.log10(stderr))
    size = max(abs(value), stderr)
    if 1e-3 <= size < 1e6 and decimals <= 9:
        shown = max(decimals, 0)
        pair = round(value, decimals), round(stderr, decimals)
        return f"{pair[0]:.{shown}f} ± {pair[1]:.{shown}f}".replace("-", "−")
    exponent = math.floor(math.log10(size))
    decimals = max(0, exponent + decimals)
    if decimals > 9:
        return f"{value:.10g} ± {stderr:.1e}".replace("-", "−")
    scale = 10.0**exponent
    pair_text = f"({value / scale:.{decimals}f} ± {stderr / scale:.{decimals}f})"
    return f"{pair_text} · 10{str(exponent).translate(_SUPERSCRIPTS)}".replace("-", "−")


def number(value: float | None, digits: int = 4) -> str:
    """A number for people; `—` for none."""
    if value is None or not math.isfinite(value):
        return "—"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa} · 10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    return text.replace("-", "−")


def share(part: float | None) -> str:
    """A share in percent, rounded down: nothing short of all is 100 %."""
    if part is None or not math.isfinite(part):
        return "—"
    return f"{math.floor(part * 1e4) / 100:.4g} %".replace("-", "−")


def curve_in_words(described: str | Mapping[str, float]) -> str:
    """A tone curve as fit.json has it, in words."""
    if isinstance(described, str):
        return f"tone curve {described}"
    numbers = ", ".join(f"{name} {number(value)}" for name, value in described.items())
    form = "1 − exp(−exposure · light)" if "exposure" in described else "light^(1/gamma)"
    return f"tone curve {form}, {numbers}"
