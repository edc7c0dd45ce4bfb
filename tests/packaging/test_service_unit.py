"""The unit of the permanent service: systemd loads it, its exposure is low, and a crash ends no host."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from lfield.provision.robot_facts import CURRENT, SETTINGS

#: Upper bound of the exposure level of `systemd-analyze security`.
MAX_EXPOSURE = 2.5

needs_analyze = pytest.mark.skipif(
    not shutil.which("systemd-analyze"), reason="there is no systemd-analyze here"
)


def analyze(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = ["systemd-analyze", "--no-pager", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@needs_analyze
def test_systemd_loads_the_service_unit(unit, tmp_path):
    """The unit names an existing program, because `verify` reports a missing one."""
    text = unit.read_text(encoding="utf-8").replace(f"{CURRENT}/bin/lfield", "/bin/true")
    (tmp_path / unit.name).write_text(text, encoding="utf-8")
    done = analyze("verify", tmp_path / unit.name)
    assert (done.returncode, done.stderr) == (0, "")


@needs_analyze
def test_service_unit_has_low_exposure(unit):
    done = analyze("security", "--offline=yes", unit)
    (level,) = re.findall(r"exposure level for .*: ([0-9.]+) ", done.stdout)
    print(f"systemd-analyze security: {level}")
    assert float(level) < MAX_EXPOSURE


def test_service_unit_runs_the_provisioned_command(settings):
    assert settings["ExecStart"] == [f"{CURRENT}/bin/lfield service --host ${{LFIELD_HOST}}"]
    assert settings["EnvironmentFile"] == [f"{SETTINGS}/service.env", f"-{SETTINGS}/local.env"]


def test_crash_of_the_service_does_not_end_the_host(settings):
    assert settings["KillMode"] == ["process"]
    assert settings["Restart"] == ["always"]
    assert settings["OOMPolicy"] == ["continue"]
    assert settings["RuntimeDirectoryPreserve"] == ["yes"]
    assert settings["StartLimitIntervalSec"] == ["0"]
