"""Cases of parametrized tests: which of them a run takes, and how they are merged into items.

A run without `--every-case` takes a sample of the tests marked `few`. The sample is taken before pytest makes
an item of each case: 8,000 of 20,000 are not made.

An item costs pytest and xdist about as much as the check of one table row, and each worker collects all of
them. So the cases of a test without a fixture of its own are checked in one item, which runs all of them and
reports each failed case with its id. `pytest -k` and `pytest FILE::TEST[ID]` make one item of each case.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from typing import Any

import pytest
from _pytest.python import CallSpec

#: Scopes of fixtures that are set up once for each worker.
_SHARED = ("session", "package", "module", "class")
#: The most cases in one item. More are split into several items, so that no item takes long.
MOST_CASES = 400


@dataclasses.dataclass(frozen=True)
class MergedCases(CallSpec):
    """The parameters of the first case, for pytest, and all cases."""

    cases: tuple[CallSpec, ...] = ()


def sample(test: str, cases: Iterable[CallSpec], count: int) -> list[CallSpec]:
    """At most `count` cases, with as many values of each parameter as possible; always the same."""
    left = sorted(cases, key=lambda case: zlib.crc32(f"{test}[{case.id}]".encode()))
    indices: set[tuple[str, int]] = set()
    found: list[CallSpec] = []
    while left and len(found) < count:
        new = [len(case.indices.items() - indices) for case in left]
        found.append(left.pop(new.index(max(new))))
        indices |= found[-1].indices.items()
    return found


def take_sample(metafunc: pytest.Metafunc) -> None:
    """Keep the sample of a test that is marked `few`; a test without parameters is kept or left out whole."""
    marker = metafunc.definition.get_closest_marker("few")
    if marker is not None and metafunc._calls:
        chosen = sample(metafunc.definition.nodeid, metafunc._calls, *marker.args)
        metafunc._calls[:] = [case for case in metafunc._calls if case in chosen]


def engines(config: pytest.Config) -> list[str]:
    """The engines on which a test of the machine runs.

    `both` runs the reference engine beside the WebAssembly engine and compares them. So the reference engine
    runs alone only with `--every-case`, and on a computer without wasmtime.
    """
    if not config.option.every_case and find_spec("wasmtime"):
        return ["both"]
    return ["reference", "both"]


def is_mergeable(metafunc: pytest.Metafunc) -> bool:
    """Whether no fixture is set up for a single case."""
    if len(metafunc._calls) < 2 or hasattr(metafunc.function, "hypothesis"):
        return False
    if any(case.marks for case in metafunc._calls):
        return False
    own = set(metafunc.fixturenames) - set(metafunc._calls[0].params)
    definitions = [metafunc._arg2fixturedefs.get(name) for name in own]
    return all(found and found[-1].scope in _SHARED for found in definitions) and all(
        metafunc._params_directness.get(name) == "direct" for name in metafunc._calls[0].params
    )


def merge(metafunc: pytest.Metafunc) -> None:
    """Check the cases of a test in one item, or in a few."""
    if not is_mergeable(metafunc):
        return
    cases = metafunc._calls
    parts = [tuple(cases[first : first + MOST_CASES]) for first in range(0, len(cases), MOST_CASES)]
    metafunc._calls = [
        MergedCases(
            part[0].params,
            part[0].indices,
            part[0]._arg2scope,
            (f"part{number}",) if len(parts) > 1 else (),
            [],
            part,
        )
        for number, part in enumerate(parts, 1)
    ]


def failures_of(cases: Iterable[CallSpec], check: Callable[..., object], shared: dict[str, Any]) -> list[Any]:
    """Check every case; return the exceptions of those that failed, each with its case as a note.

    Exceptions that end a test at once are raised: Ctrl-C, the time limit, and a skip of all cases.
    """
    failed: list[BaseException] = []
    skipped: list[BaseException] = []
    count = 0
    for case in cases:
        count += 1
        try:
            check(**{**shared, **{name: case.params[name] for name in case.params}})
        except pytest.skip.Exception as error:
            skipped.append(error)
        except (Exception, pytest.fail.Exception) as error:
            if str(error).startswith("Timeout"):
                raise
            error.add_note(f"in case [{case.id}]")
            failed.append(error)
    if len(skipped) == count:
        raise skipped[0]
    return failed


def check_all(item: pytest.Function, merged: MergedCases, check: Callable[..., object]) -> None:
    """Check the merged cases of an item. Raises the one failure, or a group of all failures."""
    arguments = {name: item.funcargs[name] for name in item._fixtureinfo.argnames}
    failed = failures_of(merged.cases, check, arguments)
    if len(failed) == 1:
        raise failed[0]
    if failed:
        raise BaseExceptionGroup(f"{len(failed)} of {len(merged.cases)} cases failed", failed)
