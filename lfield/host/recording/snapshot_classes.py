"""The classes of objects in snapshots: only classes of lfield, by name; objects are made without their
constructors.

The contents of a snapshot are checked when it is written: a snapshot that cannot be restored is of no use
later.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from sys import modules
from typing import Any

import msgspec

from lfield.errors import RecordingError

#: The packages with classes of a core. Their modules have no effect when they are imported.
_PACKAGES = tuple(
    f"lfield.{name}."
    for name in ("bytecode", "capability", "host", "journal", "mission", "replication", "vm", "wire")
)
_OURS = "lfield."


def class_named(name: str) -> type:
    """The class of lfield with that name, MODULE:CLASS. Raises RecordingError."""
    module, _, path = name.partition(":")
    found: Any = _module(module)
    for part in path.split("."):
        found = getattr(found, part, None)
    if not isinstance(found, type) or not found.__module__.startswith(_OURS):
        raise RecordingError(f"a checkpoint names an unknown class: {name}")
    return found


def _module(name: str) -> object:
    """A module of lfield that is loaded, or a module of a core, which may not be loaded yet; None for
    another.
    """
    if name not in modules and name.startswith(_PACKAGES):
        try:
            import_module(name)
        except ImportError:
            return None
    return modules.get(name) if name.startswith(_OURS) else None


@lru_cache(maxsize=1024)
def reference_to(cls: type) -> str:
    """The name of a class, as of `class_named`. Raises RecordingError for a class that cannot be found by
    this name.
    """
    name = f"{cls.__module__}:{cls.__qualname__}"
    try:
        found = class_named(name)
    except RecordingError:
        found = None
    if found is not cls:
        raise RecordingError(f"a checkpoint cannot contain an object of {name}")
    return name


@lru_cache(maxsize=1024)
def require_instantiable(cls: type) -> str:
    """The name of a class whose instances can be restored. Raises RecordingError."""
    name = reference_to(cls)
    if not issubclass(cls, msgspec.Struct):
        try:
            new_instance(cls)
        except TypeError as error:
            raise RecordingError(f"a checkpoint cannot contain an object of {name}: {error}") from None
    return name


def new_instance(cls: Any) -> Any:
    """An instance without a state; the constructor is not called."""
    return cls.__new__(cls) if issubclass(cls, BaseException) else object.__new__(cls)
