"""Looks to which terms may be added, as in `air+density+saturation`.

Each set of terms is a class of its own, so that a term that is not there has no parameter, no field
and no line in the shader.
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

from .._errors import InputError, shown
from .._look import Look


class TermedLook(Look):
    """A look with `TERMS`; a subclass says what each of them brings."""

    @classmethod
    @abstractmethod
    def parameters_of(cls, term: str) -> dict[str, tuple[Any, Any]]:
        """Annotation and field of each parameter that a term brings."""

    @classmethod
    @abstractmethod
    def facts_of(cls, terms: Sequence[str]) -> dict[str, Any]:
        """What the class of a set of terms has besides: facts of `Look`, further fields."""

    @classmethod
    def check_terms(cls, terms: Sequence[str]) -> None:
        """Raise `InputError` for terms that do not go together, or not without others."""
        for name in terms:
            missing = [other for other in cls.TERM_NEEDS.get(name, ()) if other not in terms]
            if missing:
                raise InputError(
                    f"look {cls.NAME}: term {name} goes with {' and '.join(missing)}; add it"
                )

    @classmethod
    def with_terms(cls, terms: Iterable[str]) -> type[Look]:
        found = list(terms)
        for name in found:
            if name not in cls.TERMS:
                raise InputError(
                    f"look {cls.NAME}: has no term {shown(name)}; choose from "
                    f"{', '.join(cls.TERMS)}"
                )
        cls.check_terms(found)
        return _class_of(cls, tuple(name for name in cls.TERMS if name in found))


def terms_of(look: Look) -> list[str]:
    """The terms a look is made of."""
    return type(look).NAME.split("+")[1:]


@cache
def _class_of(base: type[TermedLook], terms: tuple[str, ...]) -> type[Look]:
    """The class of a set of terms, in their order."""
    if not terms:
        return base
    fields = {name: part for term in terms for name, part in base.parameters_of(term).items()}
    facts = base.facts_of(terms)
    fields |= facts.pop("fields", {})
    own: dict[str, Any] = {
        "__module__": base.__module__,
        "__doc__": base.__doc__,
        "__annotations__": {name: annotation for name, (annotation, _) in fields.items()},
        "NAME": "+".join((base.NAME, *terms)),
    }
    name = "__".join((base.__name__, *terms)).replace("-", "_")
    return type(name, (base,), own | facts | {name: field for name, (_, field) in fields.items()})


def class_named(base: type[TermedLook], name: str) -> type[Look]:
    """The class of a set of terms by its name, as unpickling asks a module for it."""
    first, *terms = name.split("__")
    if first == base.__name__ and terms:
        return base.with_terms(term.replace("_", "-") for term in terms)
    raise AttributeError(f"module {base.__module__!r} has no attribute {name!r}")
