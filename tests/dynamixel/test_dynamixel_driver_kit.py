"""The kit as users run it: command line, guard process, driver, pseudo-terminal, fake."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import pytest
from test_dynamixel_with_fake import fake_chain

from lfield.driver.messages import MessageReader, Snapshot, encode
from lfield_dynamixel.kit import KIT


@pytest.mark.process
@pytest.mark.parametrize(
    "device",
    [("--type", "Dynamixel", "--set", "id=1"), ("--type", "DynamixelGroup", "--set", "ids=[1, 2]")],
    ids=["servo", "group"],
)
def test_the_fake_passes_the_kit(device):
    with fake_chain("1:XL330-M288", "2:XM430-W350") as chain:
        command = [sys.executable, "-m", "lfield.cli.main", "kit", "dynamixel", "--endpoint", chain.endpoint]
        done = subprocess.run(
            [*command, *device, "--yes", "--json"], capture_output=True, text=True, timeout=100
        )
    findings = [json.loads(line) for line in done.stdout.splitlines()]
    assert [f for f in findings if f["outcome"] != "passed"] == []
    assert done.returncode == 0, done.stderr
    own = {check.name for check in KIT.checks if check.suits(device[1])}
    assert own <= {finding["check"] for finding in findings}


def test_a_member_without_a_number_survives_the_pipe():
    snapshot = Snapshot("arm.joints", {"positions": [0.5, math.nan], "missing": [2]}, {}, 0.0)
    (arrived,) = MessageReader().feed(encode(snapshot))
    assert arrived.values["missing"] == [2]
    assert arrived.values["positions"][0] == 0.5
    assert math.isnan(arrived.values["positions"][1])
