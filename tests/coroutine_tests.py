"""Tests that are coroutine functions.

They are called by the fixture `runner` of their folder or file, which passes positional-only parameters:

    async def test_a_coordinator_hops(team, /, tmp_path): ...

`scenario` passes what a function of the file makes. `on_bench` passes the bench of a driver and its devices,
on virtual time.
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


def scenario(
    play: str | Callable[..., Any], *arguments: Any, given: str = "", **options: Any
) -> Callable[[Coroutines], Callable[..., None]]:
    """Run a test `async def test(team, /, tmp_path)` by `play(test, *arguments, **options)`.

    `play` is a function, or the name of a fixture that returns one. `given` names parameters of the test that
    are options too: `speed`, or `option=speed`.
    """

    def play_test(function: Callable[..., Any], more: dict[str, Any], test: Coroutines) -> None:
        function(test, *arguments, **options, **more)

    return _played(play, given, play_test)


def on_bench(
    maker: str | Callable[..., Any],
    *arguments: object,
    given: str = "",
    opened: bool = True,
    **options: object,
) -> Callable[[Coroutines], Callable[..., None]]:
    """Run a test `async def test(bench, *devices, /, ...)` as the scenario of a `DriverBench`.

    `maker` creates the bench: a function, or the name of a fixture that returns one. It is called with
    `arguments`, `options`, and the parameters of the test that `given` names, as in `scenario`.
    """

    def run_on_bench(make: Callable[..., Any], more: dict[str, Any], test: Coroutines) -> None:
        bench = make(*arguments, **options, **more)
        bench.run(lambda *devices: test(bench, *devices), opened=opened)

    return _played(maker, given, run_on_bench)


def _played(
    source: str | Callable[..., Any], given: str, play: Callable[..., None]
) -> Callable[[Coroutines], Callable[..., None]]:
    passed = [word.split("=") for word in given.split()]

    def decorate(test: Coroutines) -> Callable[..., None]:
        @functools.wraps(test)
        def run(**fixtures: Any) -> None:
            function = fixtures.pop(source) if isinstance(source, str) else source
            more = {words[0]: fixtures[words[-1]] for words in passed}
            play(function, more, lambda *objects: test(*objects, **fixtures))

        own = [p for p in inspect.signature(test).parameters.values() if p.kind is not p.POSITIONAL_ONLY]
        if isinstance(source, str):
            own.append(inspect.Parameter(source, inspect.Parameter.KEYWORD_ONLY))
        run.__signature__ = inspect.Signature(own)  # type: ignore[attr-defined]
        return run

    return decorate
