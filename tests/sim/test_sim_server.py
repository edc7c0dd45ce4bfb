"""The fake as a process: its one line, its doors, and its end."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from lfield.driver.binding import DeviceBinding
from lfield.driver.sims import main as run_sim
from lfield.errors import UsageError
from lfield_sim.mavlink import SIM, parse_listen

pytestmark = pytest.mark.process


def start(*options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "lfield_sim", "mavlink", *options]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ready(process: subprocess.Popen[str]) -> tuple[str, int, str]:
    words = process.stdout.readline().split(maxsplit=2)
    assert words[0] == "ready"
    _, _, port = words[1].rpartition(":")
    return words[1], int(port), words[2].strip()


@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_it_says_one_line_answers_and_ends_with_its_stdin(transport):
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
        sock.settimeout(10)
        sock.connect(("127.0.0.1", port))
        sock.send(question)
        reader, got = dialect.MAVLink(None), []
        while not any(m.get_type() == "COMMAND_ACK" for m in got):
            got += reader.parse_buffer(sock.recv(2048)) or []
    assert {m.get_srcSystem() for m in got} == {7}
    out, err = process.communicate(timeout=10)
    assert (out, err, process.returncode) == ("", "", 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it(number):
    process = start("--listen", "udp:127.0.0.1:0")
    ready(process)
    process.send_signal(number)
    assert process.wait(10) == 0
    process.communicate()


def test_a_port_in_use_is_a_sentence():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        process = start("--listen", f"udp:127.0.0.1:{port}")
        out, err = process.communicate(timeout=20)
    assert (out, process.returncode) == ("", 69)
    assert f"cannot use udp:127.0.0.1:{port}: " in err
    assert "in use" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (["--listen", "udp:1"], 64, "cannot listen on 'udp:1'; write udp:HOST:PORT, tcp:HOST:PORT"),
        (["--param", "NO=1"], 64, "there is no parameter 'NO'"),
        (["--param", "RTL_ALT=high"], 64, "--param RTL_ALT=high: write NAME=NUMBER"),
    ],
)
def test_options_that_make_no_sense(capsys, options, status, words):
    assert run_sim(["lfield_sim.mavlink:SIM", *options]) == status
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "options", [["--battery", "2"], ["--vehicle", "1:boat"], ["--system", "0"], ["--cruise", "nan"]]
)
def test_numbers_out_of_range(capsys, options):
    with pytest.raises(SystemExit) as end:
        run_sim(["lfield_sim.mavlink:SIM", *options])
    assert end.value.code == 2
    assert "error: argument" in capsys.readouterr().err


def test_a_fake_nobody_knows(capsys):
    assert run_sim([]) == 64
    assert run_sim(["nowhere:SIM"]) == 69
    assert "the fake 'nowhere:SIM' cannot be imported" in capsys.readouterr().err


def test_listen_texts():
    assert parse_listen("tcp:127.0.0.1:5760") == ("tcp", "127.0.0.1", 5760)
    for text in ("udp:127.0.0.1:70000", "serial:/dev/x:1", "udp:", ""):
        with pytest.raises(UsageError):
            parse_listen(text)


def test_a_binding_makes_its_fake():
    device = DeviceBinding(
        agent="a", field="fc", type="Mavlink", driver="mavlink", endpoint="sim:a.fc", safe_state="land",
        options={"kind": "rover", "system": 9},
    )  # fmt: skip
    assert SIM.arguments([device]) == [
        "--listen", "udp:127.0.0.1:0", "--vehicle", "9:rover:ardupilot:a.fc",
    ]  # fmt: skip
