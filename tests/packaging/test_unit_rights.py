"""The systemd unit of a host: unneeded rights are removed, and needed ones are present."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize(
    "key",
    [
        *("NoNewPrivileges", "ProtectHome", "PrivateTmp", "PrivateMounts", "ProtectClock", "ProtectHostname"),
        *("ProtectControlGroups", "ProtectKernelLogs", "ProtectKernelModules", "ProtectKernelTunables"),
        *("LockPersonality", "RestrictNamespaces", "RestrictSUIDSGID", "RemoveIPC"),
    ],
)
def test_unneeded_rights_are_removed(settings, key):
    assert settings[key] == ["yes"]


def test_unit_has_no_capability_and_a_private_umask(settings):
    assert settings["CapabilityBoundingSet"] == settings["AmbientCapabilities"] == [""]
    assert settings["UMask"] == ["0077"]
    assert settings["ProtectSystem"] == ["strict"]
    assert settings["SystemCallArchitectures"] == ["native"]


def test_serial_ports_can_and_network_are_allowed(settings):
    assert settings["DevicePolicy"] == ["closed"]
    allowed = {f"char-{kind} rw" for kind in ("ttyS", "ttyAMA", "ttyUSB", "ttyACM", "ttyTHS")}
    assert set(settings["DeviceAllow"]) == allowed
    assert settings["SupplementaryGroups"] == ["dialout"]
    assert set(settings["RestrictAddressFamilies"][0].split()) == {"AF_INET", "AF_INET6", "AF_UNIX", "AF_CAN"}


def test_guards_may_use_realtime_and_landlock(settings):
    assert settings["LimitRTPRIO"] == ["1"]
    assert settings["RestrictRealtime"] == ["no"]
    # A later line may restore calls that an earlier one removes.
    allowed, removed, *restored = settings["SystemCallFilter"]
    assert (allowed, removed[0]) == ("@system-service", "~")
    calls = {name for line in restored for name in line.split()}
    landlock = {f"landlock_{call}" for call in ("create_ruleset", "add_rule", "restrict_self")}
    assert calls == landlock | {"sched_setscheduler", "prlimit64", "setrlimit"}


def test_machine_code_caller_uid_and_serial_number_are_allowed(settings):
    assert settings["MemoryDenyWriteExecute"] == settings["PrivateUsers"] == ["no"]
    assert settings["ProcSubset"] == ["all"]


def test_state_cache_and_runtime_folders_are_set(settings):
    for folder in ("StateDirectory", "CacheDirectory", "RuntimeDirectory"):
        assert settings[folder] == ["lfield"]
