"""The sandbox policy for an endpoint and options, and its enforcement on a process."""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest, Option
from lfield.driver.driver_index import DriverInfo
from lfield.guard.sandbox import describe_sandbox, landlock_abi
from lfield.guard.sandbox_policy import PSEUDO_DEVICES, SYSTEM, policy_for
from lfield.manifest import DeviceManifest
from lfield.testing.driver_bench import bind, guarded, running_fake
from lfield_dynamixel import PLUGIN

MANIFEST = Manifest(
    DeviceManifest("Lamp", "lamp", ()), options=(Option("key", "path", ""), Option("id", "int", 1))
)
KNOWN = DriverInfo("lamp", "lfield_lamp:PLUGIN", {"Lamp": MANIFEST}, {}, "")


def policy_of(*endpoints, **options):
    devices = [
        DeviceBinding(
            agent="a",
            field=f"x{at}",
            type="Lamp",
            driver="lamp",
            endpoint=endpoint,
            safe_state="",
            options=options,
        )
        for at, endpoint in enumerate(endpoints)
    ]
    return policy_for(devices, KNOWN, ["/code"], "/scratch")


def test_board_port_is_the_only_writable_file():
    found = policy_of("serial:/dev/ttyAMA0:57600")
    assert set(found.writable) == {*PSEUDO_DEVICES, "/dev/ttyAMA0"}
    assert (found.folders, found.ports, found.has_internet, found.may_execute) == ((), (), False, False)
    assert found.readable == (*SYSTEM, "/code")


def test_removable_port_makes_its_folder_accessible(tmp_path):
    (tmp_path / "by-id").symlink_to("/dev/ttyUSB7")
    for endpoint in ("slcan:/dev/ttyACM0@115200?bitrate=500000", f"serial:{tmp_path}/by-id:57600"):
        found = policy_of(endpoint)
        assert (found.folders, found.has_internet) == (("/dev",), False)


@pytest.mark.parametrize(
    ("endpoint", "ports", "internet"),
    [
        ("socketcan:can0", (), False),
        ("tcp:10.0.0.7:5760", (5760,), True),
        ("socketcand:10.0.0.7:29536/can0", (29536,), True),
        ("udpin:0.0.0.0:14550", (), True),
        ("udp:10.0.0.7:14550, tcp:10.0.0.7:5760", (5760,), True),
    ],
)
def test_network_access_by_endpoint(endpoint, ports, internet):
    found = policy_of(endpoint)
    assert (found.ports, found.has_internet, found.may_execute, found.folders) == (ports, internet, False, ())


def test_unknown_endpoint_kind_has_wide_access():
    found = policy_of("process:")
    assert (found.ports, found.has_internet, found.may_execute, found.folders) == (
        None,
        True,
        True,
        ("/dev", "/scratch"),
    )
    assert "/code" in found.readable


def test_file_of_an_option_is_readable_and_its_folder_writable(tmp_path):
    found = policy_of("serial:/dev/ttyS0:57600", key=str(tmp_path / "signing.key"))
    assert str(tmp_path / "signing.key") in found.readable
    assert found.folders == (str(tmp_path),)
    assert policy_of("serial:/dev/ttyS0:57600", key="/no/such/folder/key").folders == ()
    (tmp_path / "keys").mkdir()
    found = policy_of("serial:/dev/ttyS0:57600", key=str(tmp_path / "signing.key"))
    assert (found.readable[-1], found.folders) == (str(tmp_path / "signing.key"), ())


ACCESS_SCRIPT = """
import json, os, socket, sys
from lfield.guard.sandbox import apply_sandbox
from lfield.guard.sandbox_policy import SandboxPolicy

folder = sys.argv[1]
code = ("/usr", "/lib", "/proc", *filter(None, sys.path), sys.prefix, sys.base_prefix)
apply_sandbox(SandboxPolicy(code, ("/dev/null", f"{folder}/own"), (f"{folder}/mine",), f"{folder}/rec"))

def result_of(access):
    try:
        access()
    except OSError as error:
        return type(error).__name__
    return "done"

def write(path):
    with open(path, "wb") as file:
        file.write(b"x")

print(json.dumps({
    "write own device": result_of(lambda: write(f"{folder}/own")),
    "write in own folder": result_of(lambda: write(f"{folder}/mine/new")),
    "write a recording": result_of(lambda: write(f"{folder}/rec/new")),
    "remove a recording": result_of(lambda: os.unlink(f"{folder}/rec/old")),
    "read a recording": result_of(lambda: open(f"{folder}/rec/core").close()),
    "create a folder in a recording": result_of(lambda: os.mkdir(f"{folder}/rec/sub")),
    "read code": result_of(lambda: open(os.__file__).close()),
    "write another device": result_of(lambda: write(f"{folder}/other")),
    "read a key": result_of(lambda: open(f"{folder}/host.key").close()),
    "create a file": result_of(lambda: write(f"{folder}/new")),
    "remove a file": result_of(lambda: os.unlink(f"{folder}/other")),
    "start another program": result_of(lambda: os.posix_spawn("/usr/bin/env", ["env"], {})),
    "signal the host": result_of(lambda: os.kill(os.getppid(), 0)),
    "signal itself": result_of(lambda: os.kill(os.getpid(), 0)),
    "open an internet socket": result_of(lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).close()),
    "open a Unix socket": result_of(lambda: socket.socketpair()[0].close()),
    "read memory of the host": result_of(lambda: open(f"/proc/{os.getppid()}/mem", "rb").close()),
}))
"""


@pytest.mark.skipif(landlock_abi() < 6, reason="the Landlock of this kernel lacks some tested rules")
def test_sandboxed_process_has_only_the_permitted_access(tmp_path):
    for name in ("own", "other", "host.key"):
        (tmp_path / name).write_bytes(b"secret")
    (tmp_path / "mine").mkdir()
    (tmp_path / "rec").mkdir()
    for name in ("old", "core"):
        (tmp_path / "rec" / name).touch()
    command = [sys.executable, "-c", ACCESS_SCRIPT, str(tmp_path)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert process.returncode == 0, process.stderr
    found = json.loads(process.stdout)
    permitted = {
        "write own device",
        "write in own folder",
        "write a recording",
        "remove a recording",
        "read code",
        "signal itself",
        "open a Unix socket",
    }
    assert {access for access, result in found.items() if result == "done"} == permitted, found
    assert found["open an internet socket"] == "OSError"
    assert (tmp_path / "other").read_bytes() == b"secret"
    assert describe_sandbox()[1] == ""


@pytest.mark.process
@pytest.mark.skipif(not landlock_abi(), reason="this kernel has no Landlock")
def test_guard_of_a_serial_port_has_no_host_files_and_is_sandboxed(tmp_path):
    (tmp_path / "host.key").write_text("secret")
    with running_fake("dynamixel") as fake, (tmp_path / "host.key").open() as key_file:
        os.set_inheritable(key_file.fileno(), True)

        async def scenario():
            bound = bind(PLUGIN, "Dynamixel", endpoint=fake.endpoint, waivers=["no_homing"])
            async with guarded(bound) as (joint,):
                guard = Path(f"/proc/{joint.guard_pid}")
                files = {os.readlink(entry) for entry in (guard / "fd").iterdir()}
                status = (guard / "status").read_text()
                return files, status

        files, status = asyncio.run(scenario())
    assert not any(str(tmp_path) in name for name in files), files
    assert re.search(r"NoNewPrivs:\t1\n", status)
    assert re.search(r"Seccomp:\t2\n", status)
