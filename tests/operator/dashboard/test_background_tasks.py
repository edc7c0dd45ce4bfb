"""Background tasks end with the body of their context, and end it when they fail."""

from __future__ import annotations

import asyncio

import pytest

from lfield.operator.dashboard.event_stream.background_task import background_tasks


class Bug(Exception):
    """A programming error."""


async def forever(ended: list[str]) -> None:
    try:
        await asyncio.sleep(1e6)
    finally:
        ended.append("ended")


async def fail() -> None:
    await asyncio.sleep(0.0)
    raise Bug


async def test_background_tasks_end_with_the_body() -> None:
    ended: list[str] = []

    async with background_tasks(forever(ended)):
        await asyncio.sleep(0.0)
    assert ended == ["ended"]


def test_an_error_of_a_background_task_is_raised_in_the_body() -> None:
    ended: list[str] = []

    async def main() -> None:
        async with background_tasks(forever(ended), fail()):
            await asyncio.sleep(60.0)

    with pytest.raises(Bug):
        asyncio.run(main())
    assert ended == ["ended"]


def test_an_exception_of_the_body_is_raised_unchanged() -> None:
    async def main() -> None:
        async with background_tasks(forever([])):
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        asyncio.run(main())


def test_cancelling_the_body_cancels_its_background_tasks() -> None:
    ended: list[str] = []

    async def main() -> None:
        async with background_tasks(forever(ended)):
            await asyncio.sleep(60.0)

    async def outside() -> None:
        task = asyncio.create_task(main())
        await asyncio.sleep(0.01)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(outside())
    assert ended == ["ended"]
