"""Shapes of arrays, held while tests run: ``Annotated[Array, "k 3"]`` in a signature is a promise, and a call that
breaks it fails.

The running program knows nothing of this: :class:`typing.Annotated` costs it nothing. Here an import hook reads the
annotations of a module as it is loaded and puts jaxtyping's check, with beartype behind it, around its functions,
methods and dataclasses. A letter stands for one length within a call; numbers are lengths; ``...`` are any axes.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import FunctionType, ModuleType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
from beartype import beartype
from beartype.vale import Is
from jaxtyping import Bool, Complex, Float, Int, jaxtyped
from numpy.typing import ArrayLike

PACKAGES = (
    "groundstation.flightdata",
    "groundstation.frames",
    "groundstation.trajectory",
    "groundstation.model",
    "groundstation.planning",
    "groundstation.identification",
    "groundstation.diagnosis",
)
"""Where annotations are read."""
WORD = re.compile(r"\w+")
KINDS = {np.float64: Float, np.complex128: Complex, np.bool_: Bool, np.int64: Int, np.intp: Int}
checked: set[str] = set()
"""What is checked by now: ``module.function`` or ``module.Class.method``."""


def shaped(hint: Any) -> Any:
    """The hint with jaxtyping's check wherever an array has a shape; what has none is not looked at."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated and isinstance(arguments[1], str):
        array, shape = arguments[:2]
        if array == ArrayLike:
            kind = Float[np.ndarray, shape]
            return Annotated[object, Is[lambda value: isinstance(np.asarray(value, dtype=float), kind)]]
        return KINDS[get_args(get_args(array)[1])[0]][np.ndarray, shape]
    if origin in (Union, UnionType):
        return Union[tuple(shaped(each) for each in arguments)]  # noqa: UP007 - made of what is known now
    if origin in (tuple, list, dict):
        return origin[tuple(each if each is Ellipsis else shaped(each) for each in arguments)]
    return object if arguments or not isinstance(hint, type) else hint


def hold(function: FunctionType, name: str) -> FunctionType | None:
    """The function with its shapes checked; None where its signature has none."""
    known = function.__globals__
    aliases = {name for name, value in known.items() if get_origin(value) is Annotated}
    hints = {
        key: shaped(eval(note, known))  # noqa: S307 - our own source
        for key, note in function.__annotations__.items()
        if isinstance(note, str) and ("Annotated[" in note or aliases & set(WORD.findall(note)))
    }
    if not hints:
        return None
    function.__annotations__ = hints
    checked.add(name)
    return jaxtyped(typechecker=beartype)(function)


def _functions(owner: ModuleType | type) -> Iterator[tuple[str, FunctionType, Callable[[FunctionType], Any]]]:
    """Functions defined here, each with what it is to be wrapped in again."""
    for name, value in list(vars(owner).items()):
        if isinstance(value, FunctionType):
            yield name, value, lambda function: function
        elif isinstance(value, classmethod | staticmethod):
            yield name, value.__func__, type(value)
        elif isinstance(value, property) and isinstance(value.fget, FunctionType):
            yield name, value.fget, property


def hold_module(module: ModuleType) -> None:
    """Check shapes in a module's functions, methods and dataclasses from now on."""
    owners = [module, *(v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__)]
    for owner in owners:
        stem = module.__name__ if owner is module else f"{module.__name__}.{owner.__qualname__}"
        for name, function, wrapped in _functions(owner):
            if function.__module__ == module.__name__ or name == "__init__":
                held = hold(function, f"{stem}.{name}")
                if held is not None:
                    setattr(owner, name, wrapped(held))


class _Loader(Loader):
    """Loads as the loader it replaces, then holds the shapes."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        hold_module(module)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)


class Finder(MetaPathFinder):
    """Finds the modules whose shapes are held."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(PACKAGES):
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _Loader(spec.loader)
        return spec


def install() -> None:
    """Before the first import of what is to be checked."""
    loaded = [name for name in sys.modules if name.startswith(PACKAGES)]
    assert not loaded, f"imported before shapes are held: {loaded}"
    sys.meta_path.insert(0, Finder())
