"""The parts of `make test-sitl` without a simulator: relay, command lines, and one check on a fake."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect
from sitl_relay import Frames, Relay
from sitl_simulators import KINDS, Simulator, ardupilot, px4, split, start_error
from sitl_watcher import Watcher

from lfield.testing.driver_bench import running_fake

HERE = Path(__file__).parent
ARDUCOPTER, _, PX4 = KINDS


def packet(number: int, *, signed: bool = False) -> bytes:
    """A packet of MAVLink 2 with a number in it."""
    writer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    if signed:
        writer.signing.secret_key, writer.signing.sign_outgoing = bytes(32), True
    return bytes(dialect.MAVLink_timesync_message(number, 0).pack(writer))


@given(
    st.lists(st.tuples(st.integers(1, 2**40), st.booleans()), max_size=6),
    st.lists(st.integers(1, 30), max_size=40),
)
def test_packets_are_cut_from_a_stream_in_any_pieces(numbers, pieces):
    packets = [packet(number, signed=signed) for number, signed in numbers]
    stream, frames, found = b"\0noise".join(packets), Frames(), []
    for length in [*pieces, len(stream)]:
        found += frames.cut(stream[:length])
        stream = stream[length:]
    assert found == packets


def test_relay_drops_the_configured_share_of_packets_in_both_directions():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(60.0)
        relay = Relay(f"udp:127.0.0.1:{vehicle.getsockname()[1]}", 0.2)
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
                station.connect(("127.0.0.1", int(relay.endpoint.rpartition(":")[2])))
                station.settimeout(60.0)
                for number in range(1, 501):
                    station.send(packet(number))
                    while relay.passed + relay.lost < number:
                        pass
                _, address = vehicle.recvfrom(4096)
                for number in range(1, 501):
                    vehicle.sendto(packet(number), address)
                    while relay.passed + relay.lost < 500 + number:
                        pass
                assert station.recv(4096) in {packet(number) for number in range(1, 501)}
        finally:
            relay.close()
    assert 0.15 < relay.lost / 1000 < 0.25


def test_builds_are_started_with_their_own_ports_and_ids(tmp_path):
    build = tmp_path / "ap" / "build" / "sitl" / "bin" / "arducopter"
    stock = tmp_path / "ap" / "Tools" / "autotest" / "default_params" / "copter.parm"
    stock.parent.mkdir(parents=True)
    stock.touch()
    second = Simulator(ARDUCOPTER, f"{build} --rate 400", 1)
    words, _ = ardupilot(second)
    assert words[0] == str(build)
    assert words[-2:] == ["--rate", "400"]
    assert words[words.index("--sysid") + 1] == "2"
    assert words[words.index("--defaults") + 1].startswith(f"{stock},")
    assert (second.endpoint, second.second_endpoint, second.system) == (
        "tcp:127.0.0.1:5770",
        "tcp:127.0.0.1:5772",
        2,
    )

    binary = tmp_path / "px4" / "bin" / "px4"
    (tmp_path / "px4" / "etc").mkdir(parents=True)
    words, environment = px4(Simulator(PX4, str(binary)), tmp_path)
    assert words == [str(binary), "-i", "0", "-d", "-w", str(tmp_path), str(tmp_path / "px4" / "etc")]
    assert environment == {"PX4_SIM_MODEL": "sihsim_quadx"}

    running = Simulator(ARDUCOPTER, "tcp:127.0.0.1:5760,tcp:127.0.0.1:5762")
    assert (running.endpoint, running.second_endpoint) == ("tcp:127.0.0.1:5760", "tcp:127.0.0.1:5762")


def test_build_path_is_relative_home_or_on_the_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    build = tmp_path / "build" / "arducopter"
    build.parent.mkdir()
    build.touch()
    assert split("build/arducopter --rate 400") == [str(build), "--rate", "400"]
    assert split("~/build/arducopter") == [str(build)]
    assert split("sh")[0].endswith("/sh")


@pytest.mark.parametrize(
    ("content", "mode", "words"),
    [
        (b"#!/bin/sh\n", 0o644, "Permission denied; it is no program, or has no execution right: chmod +x"),
        (b"\x7fELF\x02\x01\x01" + bytes(57), 0o755, "Exec format error; it is built for another kind of"),
        (b"#!/nowhere/loader\n", 0o755, "the file is there, but not the loader that it was built for"),
    ],
)
def test_build_that_cannot_be_started_has_a_reason(tmp_path, monkeypatch, content, mode, words):
    monkeypatch.setattr(Simulator, "ports", ())
    build = tmp_path / "arducopter"
    build.write_bytes(content)
    build.chmod(mode)
    with pytest.raises(OSError, match=r"denied|format|No such") as error:
        Simulator(ARDUCOPTER, str(build)).start(tmp_path / "run")
    assert words in start_error(str(build), error.value)


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_simulator_port_in_use_is_named(tmp_path, monkeypatch, kind):
    with socket.socket(socket.AF_INET, kind) as other_socket:
        other_socket.bind(("127.0.0.1", 0))
        if kind is socket.SOCK_STREAM:
            other_socket.listen()
        port = other_socket.getsockname()[1]
        monkeypatch.setattr(Simulator, "ports", ((kind, port),))
        with pytest.raises(OSError, match="in use") as error:
            Simulator(PX4, "/bin/true").start(tmp_path / "run")
    assert f"port {port} of 127.0.0.1 is in use; end what runs there" in start_error("/bin/true", error.value)


def test_slow_simulator_time_is_measured(monkeypatch):
    watcher = Watcher.__new__(Watcher)
    watcher.times = [(float(n), 0.6 * n) for n in range(20)]
    monkeypatch.setattr("sitl_watcher.time.monotonic", lambda: 19.0)
    assert watcher.pace(10.0) == pytest.approx(0.6)
    assert watcher.pace(1.0) is None


@pytest.mark.process
def test_ended_simulator_reports_its_last_output(tmp_path):
    build = tmp_path / "arducopter"
    build.write_text("#!/bin/sh\necho no such model\nexit 1\n")
    build.chmod(0o755)
    broken = Simulator(ARDUCOPTER, str(build))
    broken.start(tmp_path / "broken")
    broken._process.wait(30.0)
    assert broken.failure.startswith("arducopter has ended with 1; last output: no such model\n")
    broken.end()


def run_checks(arducopter: str, only: str) -> subprocess.CompletedProcess[str]:
    """Runs the checks as `make test-sitl` does for this simulator."""
    environment = {**os.environ, "ARDUCOPTER": arducopter, "LFIELD_SITL": "yes", "ONLY": only}
    arguments = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        str(HERE / "test_sitl.py"),
    ]
    return subprocess.run(
        arguments, env=environment, cwd=HERE.parents[1], capture_output=True, text=True, check=False
    )


@pytest.mark.few(0)
@pytest.mark.process
@pytest.mark.parametrize(
    ("setting", "only", "expected"),
    [
        ("/nowhere/arducopter", "left", "ARDUCOPTER: '/nowhere/arducopter' cannot be started: No such file"),
        ("/bin/false", "left", "arducopter has ended with 1; last output: nothing"),
        ("/bin/false", "nosuch", "ONLY: there is no check 'nosuch'; there are arming_right_after_opening,"),
    ],
)
def test_impossible_run_is_reported_without_a_traceback(setting, only, expected):
    done = run_checks(setting, only)
    assert done.returncode != 0
    assert expected in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr


@pytest.mark.few(0)
@pytest.mark.process
def test_check_on_a_running_vehicle_is_in_the_table():
    with running_fake("mavlink", "--listen", "udp:127.0.0.1:0", "--climb", "8", "--land", "1.9") as fake:
        done = run_checks(fake.endpoint, "left")
    assert done.returncode == 0, done.stdout
    assert "up refused a stock vehicle and named lfield setup" in done.stdout
