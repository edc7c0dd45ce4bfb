"""A numbered stream as a transport, on both event loops."""

from __future__ import annotations

import asyncio

import pytest
import uvloop

from lfield.net.zenoh.pipe import ZenohPipe
from lfield.net.zenoh.stream import NumberedStream


@pytest.mark.parametrize("loop_factory", [asyncio.new_event_loop, uvloop.new_event_loop])
def test_an_overdue_stream_may_change_its_timer(loop_factory):
    """uvloop returns a handle without a time for a timer that is due at once."""
    sent = []

    async def main():
        now = asyncio.get_running_loop().time()
        pipe = ZenohPipe(NumberedStream(now - 5.0, calls=True), ("far", 1), sent.append, lambda: None)
        pipe.on_suspicion()
        await asyncio.sleep(0.01)
        pipe.abort()

    with asyncio.Runner(loop_factory=loop_factory) as runner:
        runner.run(main())
    assert sent
