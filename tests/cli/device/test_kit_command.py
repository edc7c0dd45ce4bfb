"""`lfield kit`: its refusals, and its output."""

from __future__ import annotations

import json

import pytest

pytestmark = pytest.mark.process


@pytest.fixture
def bus(lfield):
    """The endpoint of two axes."""
    arguments = ("--device", "cia402:5", "--device", "cia402:6", "--until-stdin-closes")
    return lfield.start("sim", "can", *arguments, stdin=True).wait_for(r"^ready (\S+)")[1]


@pytest.mark.parametrize(
    ("words", "status", "sentence"),
    [
        (
            ["pigeon", "--endpoint", "loft"],
            64,
            "there is no driver 'pigeon' (installed: can, dynamixel, mavlink",
        ),
        (["mavlink"], 64, "no endpoint: give --endpoint, or --devices with a devices file"),
        (["mavlink", "--endpoint", "udp:127.0.0.1:1", "--set", "ttl"], 64, "--set ttl: write KEY=VALUE"),
        (["can", "--endpoint", "socketcand:127.0.0.1:1/can0"], 64, "is a CanAxis or a CanSignals"),
        (["mavlink", "--devices", "none.yaml"], 66, "none.yaml"),
        (["mavlink", "--devices", "kit.devices.yaml", "--type", "Mavlink"], 64, "without --devices"),
        (["mavlink", "--endpoint", "udp:127.0.0.1:1", "--set", "wings=2"], 65, "wings"),
    ],
)
def test_an_invalid_command_line_is_refused_with_a_sentence(here, words, status, sentence):
    kit = here("kit", *words, "--silence", "2", status=status)
    assert sentence in "\n".join(kit.err)
    assert kit.out == []


@pytest.mark.few(0)
def test_a_missing_endpoint_is_one_sentence(here):
    axis = ("--set", "protocol=cia402", "--set", "node=5", "--set", "counts=100")
    for arguments in (
        ("mavlink", "--endpoint", "udp:127.0.0.1:1", "--set", "connect=0.3"),
        ("can", "--type", "CanAxis", "--endpoint", "socketcand:127.0.0.1:1/can0", *axis),
        ("dynamixel", "--type", "Dynamixel", "--endpoint", "serial:/dev/there-is-none:57600"),
    ):
        kit = here("kit", *arguments, "--silence", "2", status=69)
        assert kit.out == []
        assert kit.err[0].startswith("kit.device: ")
        assert len(kit.err) == 1


def test_devices_of_a_file_are_checked_as_json_without_consent(lfield, bus, here):
    axis = f"driver: can, endpoint: '{bus}', type: CanAxis, protocol: cia402, counts: 10000"
    lfield.write(
        "crane.yaml",
        f"agents:\n  crane: {{devices: {{hoist: {{{axis}, node: 5}}, trolley: {{{axis}, node: 6}}}}}}\n",
    )
    kit = here("kit", "can", "--devices", "crane.yaml", "--json", "--silence", "2", status=0)
    findings = [json.loads(line) for line in kit.out]
    assert all(set(finding) == {"device", "check", "outcome", "seen"} for finding in findings)
    identities = {f["device"]: f["seen"] for f in findings if f["check"] == "identity"}
    assert set(identities) == {"crane.hoist", "crane.trolley"}
    assert f"node 6, vendor 0xF1D, product 0x402 at {bus}" in identities["crane.trolley"]
    assert {f["outcome"] for f in findings} == {"passed", "not run"}
    turns = [f for f in findings if f["check"] == "turns there and back"]
    assert {f["seen"] for f in turns} == {"it would move the device, which was not permitted"}


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("driver", "fake", "settings", "passed"),
    [
        ("dynamixel", ["--servo", "1:XM430-W350"], ["id=1"], 6),
        ("mavlink", ["--listen", "udp:127.0.0.1:0", "--set-up"], ["waivers=[device_watchdog]"], 11),
    ],
)
def test_checks_without_motion_run_on_a_fake(lfield, driver, fake, settings, passed, here):
    """tests/kits has the complete kits, in virtual time."""
    sim = lfield.start("sim", driver, *fake, "--until-stdin-closes", stdin=True)
    arguments = [argument for setting in settings for argument in ("--set", setting)]
    types = ["--type", "Dynamixel"] if driver == "dynamixel" else []
    where = sim.wait_for(r"^ready (\S+)")[1]
    kit = here("kit", driver, "--endpoint", where, *types, *arguments, "--silence", "2", status=0)
    assert kit.out[0].startswith("ok      kit.device: endpoint: ")
    assert kit.out[1].startswith("ok      kit.device: identity: ")
    assert kit.out[-1].startswith(f"{passed} passed, 0 failed, ")


@pytest.mark.few(0)
def test_an_endpoint_option_replaces_those_of_the_file(lfield, bus):
    lfield.write(
        "crane.yaml",
        "agents: {crane: {devices: {hoist: {driver: can, endpoint: 'socketcan:can7', type: CanAxis, "
        "protocol: cia402, counts: 10000, node: 5}}}}\n",
    )
    kit = lfield("kit", "can", "--devices", "crane.yaml", "--endpoint", bus, "--silence", "2", status=0)
    assert kit.out[1].startswith("ok      crane.hoist: identity: CiA 402 drive, node 5")
    assert kit.out[-1].startswith("5 passed, 0 failed, ")
