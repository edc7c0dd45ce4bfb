"""An update of lfield starts after the check of all robots."""

from __future__ import annotations

import asyncio

from lfield.provision.host_provisioning import UpdateGate


async def test_host_waits_for_all_checks_and_learns_the_refusing_hosts():
    gate = UpdateGate(["alpha", "bravo", "carol"])
    gate.on_checked("alpha")
    waiting = asyncio.create_task(gate.refusing("alpha"))
    gate.on_checked("bravo", refuses=True)
    await asyncio.sleep(0)
    assert not waiting.done()
    # This host is unreachable.
    gate.on_checked("carol")
    assert await waiting == ["bravo"]
    # At its end each host is reported again, which changes nothing.
    gate.on_checked("bravo")
    assert await gate.refusing("bravo") == []
    assert await gate.refusing("carol") == ["bravo"]
