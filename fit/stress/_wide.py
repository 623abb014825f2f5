"""Any JAX function, run in numbers of 50 digits: what rounding does to it, whoever wrote it.

`Wide` traces the function as JAX does, slopes included, and walks its jaxpr with `mpmath`
numbers. So it tells what float32 and float64 lose, of every look and its gradient, and nothing of
whether the formula is right: that is other tests' affair, with formulas of their own. What a
function cuts off by design (terms of a series, nodes of a quadrature) is cut off here too.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import mpmath
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive

from ..bench._exact import DIGITS, wide

Numbers = np.ndarray
"""Of `mpmath.mpf`, or of integers and booleans as they are."""


class Wide:
    """A function in 50 digits, traced once.

    Args:
        function: takes and returns pytrees of arrays.
        args: an example of what it is given; float64, and JAX's x64 has to be on.
    """

    def __init__(self, function: Callable[..., Any], *args: Any) -> None:
        self._jaxpr, self._shape = jax.make_jaxpr(function, return_shape=True)(*args)

    def __call__(self, *args: Any) -> Any:
        """What it returns, rounded to float64 at the end.

        Raises:
            NotImplementedError: an operation that this walk does not know.
        """
        with mpmath.workdps(DIGITS):
            leaves = [_wide(leaf) for leaf in jax.tree.leaves(args)]
            found = [_narrow(value) for value in _walk(self._jaxpr, leaves)]
        return jax.tree.unflatten(jax.tree.structure(self._shape), found)


def _wide(value: Any) -> Numbers:
    """An array of floats as numbers of many digits; others as they are."""
    array = np.asarray(value)
    if not np.issubdtype(array.dtype, np.floating):
        return array
    return wide(array)


def _narrow(value: Numbers) -> np.ndarray:
    return value.astype(np.float64) if value.dtype == object else value


def _each(function: Callable[..., Any], *arrays: Any) -> Numbers:
    """Applied to single numbers; also of no dimensions an array."""
    return np.asarray(np.frompyfunc(function, len(arrays), 1)(*arrays), object)


def _walk(closed: ClosedJaxpr, args: Sequence[Numbers]) -> list[Numbers]:
    jaxpr: Jaxpr = closed.jaxpr
    known: dict[Any, Numbers] = {}
    known.update(zip(jaxpr.constvars, map(_wide, closed.consts), strict=True))
    known.update(zip(jaxpr.invars, args, strict=True))

    def value(atom: Any) -> Numbers:
        return _wide(atom.val) if isinstance(atom, Literal) else known[atom]

    for eqn in jaxpr.eqns:
        given = [value(atom) for atom in eqn.invars]
        known.update(zip(eqn.outvars, _apply(eqn.primitive, given, eqn.params), strict=True))
    return [value(atom) for atom in jaxpr.outvars]


def _apply(primitive: Primitive, given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    name = primitive.name
    if name in _CALLS:
        return _walk(params[_CALLS[name]], given)
    if name in _FRAMES:
        return _FRAMES[name](given, params)
    if given and all(part.dtype != object for part in given):  # counters, masks
        found = primitive.bind(*given, **params)
        return [np.asarray(part) for part in (found if primitive.multiple_results else [found])]
    if name in _ARITHMETIC:
        return [_each(_ARITHMETIC[name], *given)]
    if name in _TESTS:
        return [_each(_TESTS[name], *given).astype(bool)]
    if name in _ARRAYS:
        return _ARRAYS[name](given, params)
    if name in _MOVES:
        return _moved(primitive, given, params)
    raise NotImplementedError(f"{name} in numbers of {DIGITS} digits")


def _moved(primitive: Primitive, given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    """What only moves numbers is left to JAX: it moves their places, and they follow."""
    sizes = np.cumsum([0, *(part.size for part in given)])
    places = [
        np.arange(low, low + part.size).reshape(part.shape)
        for low, part in zip(sizes[:-1], given, strict=True)
    ]
    pool = np.empty(int(sizes[-1]), object)
    for low, part in zip(sizes[:-1], given, strict=True):
        pool[low : low + part.size] = part.ravel()
    found = primitive.bind(*places, **params)
    parts = [np.asarray(p) for p in (found if primitive.multiple_results else [found])]
    kind = given[0].dtype
    return [pool[part.ravel()].reshape(part.shape).astype(kind) for part in parts]


def _power(x: Any, y: Any) -> Any:
    return mpmath.mpf(1) if y == 0 else mpmath.power(x, y)


def _divided(x: Any, y: Any) -> Any:
    if y != 0:
        return x / y
    return mpmath.nan if x == 0 or mpmath.isnan(x) else mpmath.sign(x) * mpmath.inf


_ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": lambda x, y: x + y,
    "add_any": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": _divided,
    "neg": lambda x: -x,
    "abs": abs,
    "max": max,
    "min": min,
    "sign": mpmath.sign,
    "sqrt": mpmath.sqrt,
    "square": lambda x: x * x,
    "exp": mpmath.exp,
    "expm1": mpmath.expm1,
    "log": lambda x: mpmath.log(x) if x > 0 else (-mpmath.inf if x == 0 else mpmath.nan),
    "log1p": mpmath.log1p,
    "pow": _power,
    "sin": mpmath.sin,
    "cos": mpmath.cos,
    "tan": mpmath.tan,
    "tanh": mpmath.tanh,
    "erf": mpmath.erf,
    "logistic": lambda x: 1 / (1 + mpmath.exp(-x)),
    "atan2": mpmath.atan2,
    "floor": mpmath.floor,
    "round": mpmath.nint,
    "exp2": lambda x: mpmath.power(2, x),
    "clamp": lambda low, x, high: min(max(low, x), high),
}

_TESTS: dict[str, Callable[..., bool]] = {
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "lt": lambda x, y: x < y,
    "le": lambda x, y: x <= y,
    "gt": lambda x, y: x > y,
    "ge": lambda x, y: x >= y,
    "is_finite": lambda x: bool(mpmath.isfinite(x)),
}

_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr"}
_CALLS |= {"custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}

_MOVES = {"broadcast_in_dim", "reshape", "slice", "squeeze", "transpose", "concatenate", "stack"}
_MOVES |= {"unstack", "split", "rev", "expand_dims", "copy", "copy_p", "optimization_barrier"}


def _picked(primitive: Primitive) -> Callable[[list[Numbers], dict[str, Any]], list[Numbers]]:
    """Places of the first, at indices that the others give."""

    def pick(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
        x, *indices = given
        if "fill_value" in params:  # of what lies beyond the edge
            params = params | {"fill_value": x.size}
        found = np.asarray(primitive.bind(np.arange(x.size).reshape(x.shape), *indices, **params))
        return [np.append(x.ravel(), mpmath.nan)[found.ravel()].reshape(found.shape)]

    return pick


def _least(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    (axis,) = params["axes"]
    return [np.asarray(np.argmin(given[0], axis=axis), params["index_dtype"])]


def _select(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    which, *cases = given
    which = np.broadcast_to(which, cases[0].shape).astype(int)
    return [np.choose(which, cases) if cases[0].ndim else np.asarray(cases[int(which)])]


def _convert(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    (x,), dtype = given, np.dtype(params["new_dtype"])
    if np.issubdtype(dtype, np.floating):
        return [x if x.dtype == object else _wide(x.astype(np.float64))]
    if x.dtype == object:
        x = _each(int, x)  # towards zero, as JAX
    return [x.astype(dtype)]


def _sum(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    (x,) = given
    return [np.asarray(x.sum(axis=tuple(params["axes"])), x.dtype)]


def _integer_power(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    return [_each(lambda x: x ** params["y"], given[0])]


def _dot(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    (left, right), (batch_left, batch_right) = params["dimension_numbers"]
    if batch_left or batch_right:
        raise NotImplementedError(f"products of batches in numbers of {DIGITS} digits")
    return [np.asarray(np.tensordot(given[0], given[1], axes=(left, right)), object)]


def _pad(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    """By its places: the value to pad with is one of them."""
    x, filling = given
    config = params["padding_config"]
    places = np.arange(x.size).reshape(x.shape)
    moved = np.asarray(jax.lax.pad(places, np.asarray(x.size), config))
    pool = np.append(x.ravel(), filling.ravel())
    return [pool[moved.ravel()].reshape(moved.shape)]


def _cond(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    which, *rest = given
    branches = params["branches"]
    return _walk(branches[int(np.clip(int(which), 0, len(branches) - 1))], rest)


def _scan(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    fixed, carried = params["num_consts"], params["num_carry"]
    constants, state = given[:fixed], list(given[fixed : fixed + carried])
    sequences = given[fixed + carried :]
    order = range(params["length"])
    stacked: dict[int, list[Numbers]] = {}
    for k in reversed(order) if params["reverse"] else order:
        out = _walk(params["jaxpr"], [*constants, *state, *(np.asarray(s[k]) for s in sequences)])
        state = out[:carried]
        stacked[k] = out[carried:]
    columns = zip(*(stacked[k] for k in order), strict=True)
    return [*state, *(np.stack(column) for column in columns)]


def _iota(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    shape, axis = params["shape"], params["dimension"]
    line = np.arange(shape[axis]).reshape([-1 if k == axis else 1 for k in range(len(shape))])
    whole = np.broadcast_to(line, shape)
    return [_wide(whole.astype(np.float64)) if params["dtype"].kind == "f" else whole]


def _empty(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
    """Numbers that nobody reads."""
    return [_wide(np.zeros(params.get("shape", ()), params["dtype"]))]


def _reduced(function: Any) -> Callable[[list[Numbers], dict[str, Any]], list[Numbers]]:
    def reduce(given: list[Numbers], params: dict[str, Any]) -> list[Numbers]:
        return [np.asarray(function.reduce(given[0], axis=tuple(params["axes"])), given[0].dtype)]

    return reduce


_FRAMES: dict[str, Callable[[list[Numbers], dict[str, Any]], list[Numbers]]] = {
    "cond": _cond,
    "scan": _scan,
    "convert_element_type": _convert,
    "iota": _iota,
    "empty": _empty,
    "empty2": _empty,
}
"""What is not numbers in, numbers out."""

_ARRAYS: dict[str, Callable[[list[Numbers], dict[str, Any]], list[Numbers]]] = {
    "select_n": _select,
    "reduce_sum": _sum,
    "reduce_max": _reduced(np.maximum),
    "reduce_min": _reduced(np.minimum),
    "argmin": _least,
    "gather": _picked(jax.lax.gather_p),
    "dynamic_slice": _picked(jax.lax.dynamic_slice_p),
    "integer_pow": _integer_power,
    "dot_general": _dot,
    "pad": _pad,
    "stop_gradient": lambda given, params: given,
}
