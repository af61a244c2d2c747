"""Functions and classes as a user calls them: signatures that can be read, wrong keywords told."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from virtual_sensor.errors import nearest

Called = TypeVar("Called", bound=Callable[..., Any])


class _Words(str):
    """An annotation that is shown as it is written."""

    def __repr__(self) -> str:
        return str(self)


def public(called: Called) -> Called:
    """Decorate a function or a class of the public API.

    `help` shows its signature as its source has it, without what begins with an underscore.  The
    error of a keyword that it does not have names the one that is meant, and all that there are.
    """
    signature = inspect.signature(called)
    names = [name for name in signature.parameters if name[0] != "_"]
    shown = signature.replace(
        parameters=[
            each.replace(annotation=_words(each.annotation))
            for name, each in signature.parameters.items()
            if name in names
        ],
        return_annotation=_words(signature.return_annotation),
    )
    if isinstance(called, type):
        called.__init__ = _checked(called.__init__, called.__name__, signature, names)  # type: ignore[misc]
        called.__signature__ = shown  # type: ignore[attr-defined]
        return called
    checked = _checked(called, called.__qualname__, signature, names)
    checked.__signature__ = shown
    return checked


def _words(annotation: Any) -> Any:
    return _Words(annotation) if isinstance(annotation, str) else annotation


def _checked(function: Any, name: str, signature: inspect.Signature, names: list[str]) -> Any:
    """A function that refuses keywords that it does not have, under its user's name for it."""
    if any(each.kind is each.VAR_KEYWORD for each in signature.parameters.values()):
        return function
    known = frozenset(signature.parameters)

    @functools.wraps(function)
    def call(*given: Any, **named: Any) -> Any:
        if not named.keys() <= known:
            raise TypeError(_unknown(name, min(named.keys() - known), names))
        return function(*given, **named)

    return call


def _unknown(function: str, keyword: str, names: Iterable[str]) -> str:
    names = [name for name in names if name not in ("self", "cls")]
    meant = nearest(keyword, names)
    if not meant and "scene" in names:
        meant = "; parameters of the scene are set by scene.with_parameters"
    return f"{function}() has no argument '{keyword}': it takes {', '.join(names)}{meant}"
