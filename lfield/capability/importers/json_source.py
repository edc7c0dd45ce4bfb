"""JSON text to plain data: objects without a key twice, no number that is not finite."""

from __future__ import annotations

import json
from typing import Any, NoReturn

from lfield.capability.importers.messages import NOT_JSON
from lfield.text.source import Diagnostics, Source, Span


def decode(name: str, data: bytes, found: Diagnostics) -> Any:
    """The value in some bytes, shown as `name` in diagnostics; None when `found` got an error."""
    source = Source(name, data.decode("utf-8-sig", "replace"))
    try:
        data.decode("utf-8")
        return json.loads(source.text, object_pairs_hook=_object, parse_constant=_constant)
    except json.JSONDecodeError as error:
        _report(source, error.pos, error.msg, found)
    except UnicodeDecodeError:
        place = source.text.find("\N{REPLACEMENT CHARACTER}")
        _report(source, max(place, 0), "it is not UTF-8 text", found)
    except RecursionError:
        _report(source, 0, "it is nested too deep", found)
    except ValueError as error:
        # A key twice, a number that is not finite, an int of thousands of digits.
        _report(source, 0, str(error), found)
    return None


def _report(source: Source, start: int, reason: str, found: Diagnostics) -> None:
    found.add(NOT_JSON.at(Span(source, start, start + 1), reason=reason))


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"{twice[:80]!r} is there twice in one object")
    return made


def _constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")
