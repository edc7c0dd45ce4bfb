"""Work beside a body ends with it, and ends it when it fails."""

from __future__ import annotations

import asyncio

import pytest

from lfield.operator.dashboard.event_stream.background_task import background_tasks


class Bug(Exception):
    """Of ours."""


async def forever(ended: list[str]) -> None:
    try:
        await asyncio.sleep(1e6)
    finally:
        ended.append("ended")


async def fail() -> None:
    await asyncio.sleep(0.0)
    raise Bug


async def test_what_is_beside_a_body_ends_with_it() -> None:
    ended: list[str] = []

    async with background_tasks(forever(ended)):
        await asyncio.sleep(0.0)
    assert ended == ["ended"]


def test_a_bug_beside_a_body_is_raised_in_it() -> None:
    ended: list[str] = []

    async def main() -> None:
        async with background_tasks(forever(ended), fail()):
            await asyncio.sleep(60.0)

    with pytest.raises(Bug):
        asyncio.run(main())
    assert ended == ["ended"]


def test_what_a_body_raises_comes_out_as_it_is() -> None:
    async def main() -> None:
        async with background_tasks(forever([])):
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        asyncio.run(main())


def test_a_body_that_is_cancelled_is_cancelled() -> None:
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
