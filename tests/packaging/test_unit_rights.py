"""The unit for systemd: what a host never needs is taken away, and all that it needs is still there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

UNIT = Path(__file__).parents[2] / "deploy" / "lfield.service"


@pytest.fixture(scope="module")
def settings() -> dict[str, list[str]]:
    """The values of every key, in their order."""
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text(encoding="utf-8").splitlines():
        if match := re.fullmatch(r"([A-Za-z]+)=(.*)", line):
            found.setdefault(match[1], []).append(match[2])
    return found


@pytest.mark.parametrize(
    "key",
    [
        *("NoNewPrivileges", "ProtectHome", "PrivateTmp", "PrivateMounts", "ProtectClock", "ProtectHostname"),
        *("ProtectControlGroups", "ProtectKernelLogs", "ProtectKernelModules", "ProtectKernelTunables"),
        *("LockPersonality", "RestrictNamespaces", "RestrictSUIDSGID", "RemoveIPC"),
    ],
)
def test_what_no_host_needs_is_taken_away(settings, key):
    assert settings[key] == ["yes"]


def test_no_capability_is_left_and_no_file_is_for_others(settings):
    assert settings["CapabilityBoundingSet"] == settings["AmbientCapabilities"] == [""]
    assert settings["UMask"] == ["0077"]
    assert settings["ProtectSystem"] == ["strict"]
    assert settings["SystemCallArchitectures"] == ["native"]


def test_serial_ports_can_and_the_network_are_there(settings):
    assert settings["DevicePolicy"] == ["closed"]
    allowed = {f"char-{kind} rw" for kind in ("ttyS", "ttyAMA", "ttyUSB", "ttyACM", "ttyTHS")}
    assert set(settings["DeviceAllow"]) == allowed
    assert settings["SupplementaryGroups"] == ["dialout"]
    assert set(settings["RestrictAddressFamilies"][0].split()) == {"AF_INET", "AF_INET6", "AF_UNIX", "AF_CAN"}


def test_guards_may_be_prompt_and_confine_themselves(settings):
    assert settings["LimitRTPRIO"] == ["1"]
    assert settings["RestrictRealtime"] == ["no"]
    # What a line takes away, a later one may give back.
    first, without, *back = settings["SystemCallFilter"]
    assert (first, without[0]) == ("@system-service", "~")
    calls = {name for line in back for name in line.split()}
    landlock = {f"landlock_{call}" for call in ("create_ruleset", "add_rule", "restrict_self")}
    assert calls == landlock | {"sched_setscheduler", "prlimit64", "setrlimit"}


def test_machine_code_the_visitors_number_and_the_serial_number_of_a_pi_stay(settings):
    assert settings["MemoryDenyWriteExecute"] == settings["PrivateUsers"] == ["no"]
    assert settings["ProcSubset"] == ["all"]


def test_what_a_host_keeps_has_a_place(settings):
    for folder in ("StateDirectory", "CacheDirectory", "RuntimeDirectory"):
        assert settings[folder] == ["lfield"]
