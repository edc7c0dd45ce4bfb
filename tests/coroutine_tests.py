"""Tests that are coroutine functions.

They are called by the fixture `runner` of their folder or file, which passes positional-only parameters:

    async def test_a_coordinator_hops(team, /, tmp_path): ...

`on_bench` passes the bench of a driver and its devices, on virtual time.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

Coroutines = Callable[..., Coroutine[Any, Any, object]]


def synchronous(item: pytest.Function) -> Callable[..., object]:
    """The function of an item; a coroutine function is called by the fixture `runner`."""
    if not inspect.iscoroutinefunction(item.obj):
        return item.obj

    def run(**arguments: object) -> object:
        return item.funcargs["runner"](lambda *given: item.obj(*given, **arguments))

    return run


def on_bench(
    maker: str | Callable[..., Any],
    *arguments: object,
    given: str = "",
    opened: bool = True,
    **options: object,
) -> Callable[[Coroutines], Callable[..., None]]:
    """Run a test `async def test(bench, *devices, /, ...)` as the scenario of a `DriverBench`.

    `maker` creates the bench: a function, or the name of a fixture that returns one. It is called with
    `arguments`, `options`, and the parameters of the test that `given` names: `speed`, or `option=speed`.
    """
    passed = [word.split("=") for word in given.split()]

    def decorate(test: Coroutines) -> Callable[..., None]:
        @functools.wraps(test)
        def run(**fixtures: Any) -> None:
            make = fixtures.pop(maker) if isinstance(maker, str) else maker
            bench = make(*arguments, **options, **{words[0]: fixtures[words[-1]] for words in passed})
            bench.run(lambda *devices: test(bench, *devices, **fixtures), opened=opened)

        own = [p for p in inspect.signature(test).parameters.values() if p.kind is not p.POSITIONAL_ONLY]
        fixture = [inspect.Parameter(maker, inspect.Parameter.KEYWORD_ONLY)] if isinstance(maker, str) else []
        run.__signature__ = inspect.Signature([*own, *fixture])  # type: ignore[attr-defined]
        return run

    return decorate
