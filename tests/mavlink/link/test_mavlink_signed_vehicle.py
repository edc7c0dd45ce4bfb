"""A vehicle with signing, through the driver."""

from __future__ import annotations

import asyncio

import pytest
from takeoff import up

from lfield.errors import DeviceError
from lfield_sim.mavlink.link.signing import MessageSigning as Gate

# -- signing ----------------------------------------------------------------------------------------------


def signed(bench, tmp_path, **options):
    """A bench whose vehicle and driver use the same key."""
    path = tmp_path / "alpha.key"
    path.write_bytes(b"k" * 32)
    path.chmod(0o600)
    b = bench(options={"signing_key": str(path)}, **options)
    fake = b.fakes[1]
    fake.gate = gate = Gate(1, lambda: b.autopilot.uptime)
    gate.key = b"k" * 32
    return b, gate


def test_vehicle_with_signing_is_flown(bench, tmp_path, monkeypatch):
    async def at_once(work, *given):
        """Virtual time does not wait for threads, and timestamps are written during the flight."""
        return work(*given)

    monkeypatch.setattr(asyncio, "to_thread", at_once)
    b, _ = signed(bench, tmp_path)

    async def mission(fc):
        await up(fc)
        await asyncio.sleep(2.0)
        assert b.values["signaturesGood"] > 100
        assert b.values["signaturesBad"] == b.values["unsignedRefused"] == 0
        packet = bytes(b.sent[-1])
        b.links[0].on_data(packet)
        await asyncio.sleep(2.0)
        assert b.values["position"][2] == pytest.approx(-5.0, abs=1.0)

    b.run(mission)
    assert all(packet[2] & 1 for packet in b.sent)


def test_vehicle_without_the_key_is_not_accepted(bench, tmp_path):
    b, gate = signed(bench, tmp_path)
    gate.key = None

    async def mission(fc):
        with pytest.raises(DeviceError, match="no heartbeat"):
            await fc.open()
        await asyncio.sleep(2.0)
        assert b.values["unsignedRefused"] > 0

    b.run(mission, opened=False)


def test_vehicle_without_the_key_is_accepted_with_a_waiver(bench, tmp_path):
    b, gate = signed(bench, tmp_path, waivers=("device_watchdog", "unsigned"))
    gate.key = None

    async def mission(fc):
        await asyncio.sleep(1.0)
        assert b.values["armed"] is False

    b.run(mission)
