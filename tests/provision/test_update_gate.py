"""An update of lfield starts only after all robots have been checked."""

from __future__ import annotations

import asyncio

from lfield.provision.host_provisioning import UpdateGate


async def test_gate_opens_after_all_checks_and_names_the_other_refusing_hosts():
    gate = UpdateGate(["alpha", "bravo", "carol"])
    gate.on_checked("alpha")
    waiting = asyncio.create_task(gate.refusing("alpha"))
    gate.on_checked("bravo", refuses=True)
    await asyncio.sleep(0)
    assert not waiting.done()
    # carol is unreachable: its failure counts as a check.
    gate.on_checked("carol")
    assert await waiting == ["bravo"]
    # Each host is reported again at the end of its provisioning; this changes nothing.
    gate.on_checked("bravo")
    assert await gate.refusing("bravo") == []
    assert await gate.refusing("carol") == ["bravo"]
