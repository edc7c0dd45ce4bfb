"""`lfield provision` without robots: its command line, and the packages it collects."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from robot_bench.desk import Desk

from lfield import exit_status
from lfield.provision import own_wheel, standalone_python

INVENTORY = """hosts:
  alpha:
    addresses: [127.0.0.1]
    ssh_port: 1
    arch: aarch64
    python: "3.11"
  bravo:
    addresses: [127.0.0.2]
    ssh_port: 1
"""


@pytest.fixture
def folder(lfield, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A desk with an inventory and wheels for a Raspberry Pi."""
    monkeypatch.setenv("XDG_CACHE_HOME", f"{lfield.folder}/.cache")
    for name in ("LFIELD_AUTHORITY", "LFIELD_INVENTORY"):
        monkeypatch.delenv(name, raising=False)
    lfield.write("inventory.yaml", INVENTORY)
    made = lfield.folder / "wheels"
    made.mkdir()
    (made / "rich-15.0.0-py3-none-any.whl").write_bytes(b"rich")
    desk = Desk(lfield.folder)
    for python in ("3.11", "3.12"):
        desk.collect_wheels(made, "aarch64", python)
    return Path(lfield.folder)


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> None:
    """lfield's own wheel needs no build."""
    monkeypatch.setattr(own_wheel, "_sources", lambda: None)
    monkeypatch.setattr(own_wheel, "_installed", lambda: None)

    def repack(installed: object, folder: Path) -> Path:
        path = folder / "lfield-0.4.0-py3-none-any.whl"
        path.write_bytes(b"lfield")
        return path

    monkeypatch.setattr(own_wheel, "repack", repack)


def reports(out: list[str]) -> dict[str, dict[str, object]]:
    """The last report of each host."""
    return {each["host"]: each for each in map(json.loads, out) if "host" in each}


@pytest.mark.usefixtures("own")
def test_prepare_needs_no_robot_whose_platform_is_in_the_inventory(folder, here) -> None:
    done = here(
        "provision", "--inventory", "inventory.yaml", "--prepare", "--json", "alpha", status=exit_status.DONE
    )
    assert reports(done.out)["alpha"]["state"] == "done"
    both = here(
        "provision", "--inventory", "inventory.yaml", "--prepare", "--json", status=exit_status.UNAVAILABLE
    )
    found = reports(both.out)
    assert (found["alpha"]["state"], found["bravo"]["state"]) == ("done", "failed")


@pytest.mark.usefixtures("own")
def test_another_python_is_prepared_for_a_robot_with_an_old_one(folder, here, monkeypatch) -> None:
    """The command installs another Python, for which it needs uv or an archive collected by uv."""
    (folder / "inventory.yaml").write_text(INVENTORY.replace('"3.11"', '"3.10"'))
    monkeypatch.setattr(standalone_python, "find_uv", lambda: None)
    prepare = ("provision", "--inventory", "inventory.yaml", "--prepare", "--json", "alpha")
    without = here(*prepare, status=exit_status.UNAVAILABLE)
    assert reports(without.out)["alpha"]["hint"] == "pip install uv"
    collected = folder / ".cache/lfield/python/aarch64-3.12.9.tar.gz"
    collected.parent.mkdir(exist_ok=True)
    collected.write_bytes(b"python")
    assert here(*prepare).status == exit_status.DONE


@pytest.mark.skipif(shutil.which("ssh") is None, reason="there is no ssh here")
def test_each_address_without_an_answer_is_named(folder, here) -> None:
    (folder / "two.yaml").write_text("hosts: {alpha: {addresses: [127.0.0.1, 127.0.0.2], ssh_port: 1}}\n")
    done = here("provision", "--inventory", "two.yaml", "--json", status=exit_status.UNAVAILABLE)
    output = str(reports(done.out)["alpha"]["message"])
    assert "127.0.0.1 is unreachable" in output
    assert "127.0.0.2 is unreachable" in output


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (("--inventory", "inventory.yaml", "alhpa"), exit_status.USAGE),
        (("--inventory", "none.yaml"), exit_status.NO_INPUT),
        ((), exit_status.USAGE),
    ],
)
def test_invalid_command_lines_of_provision_are_refused(folder, here, arguments, status) -> None:
    assert here("provision", *arguments).status == status


def test_a_devices_file_must_be_with_the_inventory(folder, here) -> None:
    (folder / "inventory.yaml").write_text(INVENTORY + "    devices: other/bravo.devices.yaml\n")
    assert here("provision", "--inventory", "inventory.yaml").status == exit_status.USAGE
