"""An update of lfield begins when all robots have been checked."""

from __future__ import annotations

import asyncio

from lfield.provision.host_provisioning import UpdateGate


def test_a_host_waits_until_all_have_been_checked_and_learns_which_refuse():
    async def story() -> None:
        gate = UpdateGate(["alpha", "bravo", "carol"])
        gate.on_checked("alpha")
        waiting = asyncio.create_task(gate.refusing("alpha"))
        gate.on_checked("bravo", refuses=True)
        await asyncio.sleep(0)
        assert not waiting.done()
        # It cannot be reached.
        gate.on_checked("carol")
        assert await waiting == ["bravo"]
        # At its end each host is reported again, which changes nothing.
        gate.on_checked("bravo")
        assert await gate.refusing("bravo") == []
        assert await gate.refusing("carol") == ["bravo"]

    asyncio.run(story())
