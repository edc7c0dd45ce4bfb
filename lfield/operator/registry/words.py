"""Pieces of a registry in words, for people: values with their units, mapped calls, signatures."""

from __future__ import annotations

from lfield.capability.model import Argument, Portal, PortalMap, Value
from lfield.capability.reading.signatures import written
from lfield.text.suggest import listed


def printable(text: str) -> str:
    """A text on one line; what a terminal would obey is shown as a dot."""
    return "".join(ch if ch.isprintable() else "·" for ch in text)


def worth(value: Value, unit: str = "") -> str:
    """A value with its unit: `2.5 kg`, `aerial and terrestrial`, `true`."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return printable(value) or '""'
        case frozenset():
            return printable(listed(sorted(value), "nothing"))
        case _:
            return with_unit(f"{value:g}", unit)


def with_unit(text: str, unit: str) -> str:
    """A text with a unit behind it, if there is one."""
    return f"{text} {unit}" if unit else text


def signature(portal: Portal) -> str:
    """A canonical portal as L would declare it: `real lift(real height)`."""
    return written(portal.name, [f"{p.type} {p.name}" for p in portal.parameters], portal.result)


def call(target: str, mapped: PortalMap) -> str:
    """A mapped call with what the caller gets instead of what that emits: `Winch.lift(height) -> height`."""
    text = f"{target}.{mapped.target}({', '.join(map(_argument, mapped.arguments))})"
    return text if mapped.result is None else f"{text} -> {_argument(mapped.result)}"


def _argument(argument: Argument) -> str:
    if argument.parameter:
        text = argument.parameter
    else:
        text = "emitted" if argument.constant is None else _constant(argument.constant)
    if argument.factor != 1:
        text += f" * {argument.factor:g}"
    return text + (f" + {argument.offset:g}" if argument.offset else "")


def _constant(value: float | int | bool | str) -> str:
    return f'"{printable(value)}"' if isinstance(value, str) else worth(value)
