"""The fake as a process: its ready line, its endpoints and control socket, and its end."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import IO

import pytest
import serial
from pymavlink.dialects.v20 import all as dialect

from lfield.driver.binding import DeviceBinding
from lfield.driver.sims import main as run_sim
from lfield.errors import UsageError
from lfield_sim.mavlink import SIM, parse_listen

pytestmark = pytest.mark.process


def start(*options: str, stdin: int | IO[str] = subprocess.PIPE) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "lfield_sim", "mavlink", *options]
    return subprocess.Popen(command, stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ready(process: subprocess.Popen[str]) -> tuple[str, int, str]:
    words = process.stdout.readline().split(maxsplit=2)
    assert words[0] == "ready"
    _, _, port = words[1].rpartition(":")
    return words[1], int(port), words[2].strip()


@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_process_prints_ready_answers_and_ends_with_its_stdin(transport):
    process = start(
        "--listen", f"{transport}:127.0.0.1:0", "--kind", "rover", "--system", "7", "--until-stdin-closes"
    )
    endpoint, port, words = ready(process)
    assert endpoint.startswith(f"{transport}:127.0.0.1:")
    assert words == "rover system 7"
    client = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    question = dialect.MAVLink_command_long_message(7, 1, 31337, 0, 0, 0, 0, 0, 0, 0, 0).pack(client)
    kind = socket.SOCK_DGRAM if transport == "udp" else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.settimeout(60)
        sock.connect(("127.0.0.1", port))
        sock.send(question)
        reader, got = dialect.MAVLink(None), []
        while not any(m.get_type() == "COMMAND_ACK" for m in got):
            got += reader.parse_buffer(sock.recv(2048)) or []
    assert {m.get_srcSystem() for m in got} == {7}
    out, err = process.communicate(timeout=60)
    assert (out, err, process.returncode) == ("", "", 0)


@pytest.mark.parametrize("lines", [None, "ignored\n"], ids=["null", "file"])
def test_a_process_whose_stdin_is_no_pipe_ends_at_its_end(lines, tmp_path):
    source = Path(os.devnull)
    if lines is not None:
        source = tmp_path / "input"
        source.write_text(lines)
    with source.open() as stdin:
        process = start("--listen", "udp:127.0.0.1:0", "--until-stdin-closes", stdin=stdin)
    out, err = process.communicate(timeout=60)
    assert (out.split()[0], err, process.returncode) == ("ready", "", 0)


def test_vehicles_of_one_link_and_faults_by_name_at_run_time(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    process = start(
        "--listen", "udp:127.0.0.1:0", "--vehicle", "3:rover", "--vehicle", "9:copter:px4:beta.fc",
        "--fault", "loss@3=0.01", "--until-stdin-closes",
    )  # fmt: skip
    _, port, words = ready(process)
    assert words == "rover system 3, copter system 9 px4"
    with socket.socket(socket.AF_UNIX) as control:
        control.connect(str(tmp_path / "lfield" / "sims" / f"mavlink-{process.pid}.sock"))
        control.sendall(b'{"set": ["silence@beta.fc=true"]}\n')
        answer = json.loads(control.makefile().readline())
    assert answer["devices"] == {"3": "", "9": "beta.fc"}
    assert "@9=true" in answer["faults"]["silence"]
    assert "@3=0.01" in answer["faults"]["loss"]
    client = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.settimeout(60)
        sock.connect(("127.0.0.1", port))
        for system in (9, 3):
            sock.send(dialect.MAVLink_command_long_message(system, 1, 512, 0, 1, *[0] * 6).pack(client))
        (received, *_) = dialect.MAVLink(None).parse_buffer(sock.recv(2048))
    assert received.get_srcSystem() == 3
    assert process.communicate(timeout=60) == ("", "")


def test_pty_endpoint_works_as_a_serial_port():
    process = start("--listen", "pty", "--flavour", "px4", "--until-stdin-closes")
    endpoint, _, _ = ready(process)
    kind, path, baud = endpoint.split(":")
    assert (kind, baud) == ("serial", "57600")
    with serial.Serial(path, int(baud), timeout=60, exclusive=True) as port:
        reader, got = dialect.MAVLink(None), []
        reader.robust_parsing = True
        client = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        port.write(dialect.MAVLink_command_long_message(1, 1, 512, 0, 148, *[0] * 6).pack(client))
        while not any(m.get_type() == "AUTOPILOT_VERSION" for m in got):
            got += reader.parse_buffer(port.read(64)) or []
    with serial.Serial(path, int(baud), timeout=60) as again:
        assert again.read(8), "the port works for the next client"
    assert process.communicate(timeout=60) == ("", "")


@pytest.mark.few(1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_the_process_with_status_0(number):
    process = start("--listen", "udp:127.0.0.1:0")
    ready(process)
    process.send_signal(number)
    assert process.wait(60) == 0
    process.communicate()


def test_port_in_use_is_reported_without_a_traceback():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as occupied:
        occupied.bind(("127.0.0.1", 0))
        port = occupied.getsockname()[1]
        process = start("--listen", f"udp:127.0.0.1:{port}")
        out, err = process.communicate(timeout=60)
    assert (out, process.returncode) == ("", 69)
    assert f"cannot use udp:127.0.0.1:{port}: " in err
    assert "in use" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (["--listen", "udp:1"], 64, "cannot listen on 'udp:1'; write udp:HOST:PORT, tcp:HOST:PORT"),
        (["--param", "NO=1"], 64, "there is no parameter 'NO'"),
        (["--param", "RTL_ALT=nan"], 64, "--param RTL_ALT=nan: no parameter can hold that"),
        (["--fault", "rain=1"], 64, "there is no fault 'rain'"),
        (["--fault", "loss@7=0.5"], 64, "there is no device '7'; there are: 1"),
        (["--vehicle", "1", "--vehicle", "1:rover"], 64, "the same system id"),
        (["--param", "RTL_ALT=high"], 64, "--param RTL_ALT=high: write NAME=NUMBER"),
    ],
)
def test_invalid_option_is_refused_with_status_and_message(capsys, options, status, words):
    assert run_sim(["lfield_sim.mavlink:SIM", *options]) == status
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "options", [["--battery", "2"], ["--vehicle", "1:boat"], ["--system", "0"], ["--cruise", "nan"]]
)
def test_number_out_of_range_is_a_usage_error(capsys, options):
    with pytest.raises(SystemExit) as end:
        run_sim(["lfield_sim.mavlink:SIM", *options])
    assert end.value.code == 2
    assert "error: argument" in capsys.readouterr().err


def test_unknown_fake_is_refused(capsys):
    assert run_sim([]) == 64
    assert run_sim(["nowhere:SIM"]) == 69
    assert "the simulated device 'nowhere:SIM' cannot be imported" in capsys.readouterr().err


def test_listen_option_is_parsed_or_refused():
    assert parse_listen("tcp:127.0.0.1:5760") == ("tcp", "127.0.0.1", 5760)
    for text in ("udp:127.0.0.1:70000", "serial:/dev/x:1", "udp:", ""):
        with pytest.raises(UsageError):
            parse_listen(text)


def bound(field: str, **options) -> DeviceBinding:
    return DeviceBinding(
        agent="a", field=field, type="Mavlink", driver="mavlink", endpoint="sim:a", safe_state="land",
        options=options,
    )  # fmt: skip


def test_bindings_of_a_bus_make_one_fake_with_setup_parameters():
    devices = [
        bound("fc", kind="rover", system=9),
        bound("up", kind="copter", system=2, autopilot="px4"),
        bound("gimbal", system=2),
    ]
    words = SIM.arguments(devices)
    assert words[:2] == ["--listen", "udp:127.0.0.1:0"]
    assert words[2:6] == ["--vehicle", "9:rover:ardupilot:a.fc", "--vehicle", "2:copter:px4:a.up"]
    # Its parameters are set up for the bindings.
    assert {"--param=FS_ACTION@9=2", "--param=NAV_DLL_ACT@2=3"} <= set(words[6:])
