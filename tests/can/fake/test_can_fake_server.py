"""The fake as a process: python-can at both endpoints, faults at run time, its ready line and its end."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
import time

import can
import pytest
from can_endpoints import opened, serial, tcp
from test_can_fake_dbc import GRIPPER

from lfield.driver.binding import DeviceBinding
from lfield.driver.sims import Sim, main
from lfield.errors import UsageError
from lfield.testing.driver_bench import running_fake
from lfield_sim.can import SIM, parse_listen

pytestmark = pytest.mark.process
BOTH = ("--listen", "socketcand:127.0.0.1:0", "--listen", "slcan-pty")


def heard(bus: can.BusABC, identifier: int, seconds: float = 60.0) -> can.Message:
    """The next frame with an identifier."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        message = bus.recv(0.1)
        if message is not None and message.arbitration_id == identifier and not message.is_error_frame:
            return message
    raise AssertionError(f"no frame {identifier:#x} in {seconds} s")


def frame(identifier: int, data: bytes = b"", **options) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=identifier > 0x7FF, **options)


def test_python_can_exchanges_frames_at_both_endpoints():
    with contextlib.ExitStack() as stack:
        fake = stack.enter_context(running_fake("can", *BOTH))
        places = (tcp(fake.ready_line[0]), tcp(fake.ready_line[0]), serial(fake.ready_line[1]))
        a, b, c = (stack.enter_context(opened(place)) for place in places)
        assert c.get_version(60.0) == (10, 13)
        a.send(frame(0x123, b"\x01\xfe"))
        for other in (b, c):
            message = heard(other, 0x123)
            assert (bytes(message.data), message.is_extended_id) == (b"\x01\xfe", False)
        c.send(frame(0x1ABCDEF0, bytes(8)))
        for other in (a, b):
            assert heard(other, 0x1ABCDEF0).is_extended_id
        assert c.get_serial_number(60.0) == "F4K3"


def test_fd_and_remote_frames_pass_slcan_endpoints():
    with contextlib.ExitStack() as stack:
        fake = stack.enter_context(running_fake("can", "--listen", "slcan-pty", "--listen", "slcan-pty"))
        a = stack.enter_context(opened(serial(fake.ready_line[0]), bitrate=1_000_000))
        b = stack.enter_context(opened(serial(fake.ready_line[1])))
        assert b.get_version(60.0) == (10, 13)
        a.send(frame(0x123, bytes(range(48)), is_fd=True, bitrate_switch=True))
        message = heard(b, 0x123)
        assert (bytes(message.data), message.is_fd, message.bitrate_switch) == (bytes(range(48)), True, True)
        a.send(can.Message(arbitration_id=0x55, is_remote_frame=True, dlc=4, is_extended_id=False))
        message = heard(b, 0x55)
        assert (message.is_remote_frame, message.dlc) == (True, 4)


def test_slcan_client_with_the_wrong_bit_rate_receives_nothing():
    with running_fake("can", *BOTH, "--device", "odrive:3") as fake:
        with opened(serial(fake.ready_line[1]), bitrate=250_000) as wrong:
            assert wrong.recv(0.5) is None
        with opened(serial(fake.ready_line[1]), bitrate=1_000_000) as right:
            heard(right, 0x61)


def client(endpoint: str) -> socket.socket:
    """A client that has requested all frames; python-can's fails on an answer together with a frame."""
    joined = socket.create_connection(("127.0.0.1", tcp(endpoint)["port"]), timeout=60.0)
    joined.sendall(b"< open can0 >< rawmode >")
    return joined


def test_clients_come_and_go_beside_one_that_does_not_read():
    with running_fake("can", "--device", "odrive:3") as fake:
        mute = client(fake.ready_line[0])
        for _ in range(5):
            with client(fake.ready_line[0]) as bus:
                output = b""
                while b"< frame 061" not in output:
                    output += bus.recv(4096)
        mute.close()


@pytest.mark.few(0)
def test_many_frames_at_once_are_delayed_but_not_lost():
    with (
        running_fake("can") as fake,
        opened(tcp(fake.ready_line[0])) as a,
        opened(tcp(fake.ready_line[0])) as b,
    ):
        for n in range(3000):
            a.send(frame(0x100, n.to_bytes(2, "big")))
        got = [int.from_bytes(heard(b, 0x100).data, "big") for _ in range(3000)]
    assert got == list(range(3000))


def test_faults_are_set_at_run_time():
    with running_fake("can", "--device", "cia402:5:alpha.winch", "--fault", "lost_heartbeat@5=true") as fake:
        assert fake.ready_line[1:] == ["cia402:5"]
        with opened(tcp(fake.ready_line[0])) as bus:
            with pytest.raises(AssertionError):
                heard(bus, 0x705, 0.5)
            answer = fake.fault("lost_heartbeat@alpha.winch=false")
            assert answer["devices"] == {"5": "alpha.winch"}
            assert answer["endpoint"] == fake.ready_line[0]
            heard(bus, 0x705)
            fake.fault("corrupt=1")
            bus.send(frame(0x100))
            end = time.monotonic() + 60
            while not (message := bus.recv(1.0)) or not message.is_error_frame:
                assert time.monotonic() < end
            with pytest.raises(AssertionError, match="corrupt"):
                fake.fault("corrupt=2")


def unplugged(place: dict[str, object]) -> bool:
    """Whether a socketcand client is disconnected before the greeting."""
    with socket.create_connection((place["host"], place["port"]), 60) as client:
        try:
            return client.recv(100) == b""
        except ConnectionResetError:
            return True


def test_unplugged_endpoints_close_and_return(tmp_path):
    link = tmp_path / "dongle"
    arguments = ("--listen", f"slcan-pty:{link}", "--listen", "socketcand:127.0.0.1:0")
    with running_fake("can", *arguments, "--device", "odrive:3") as fake:
        assert fake.ready_line[0] == f"slcan:{link}@115200"
        bus = opened(serial(fake.ready_line[0]))
        heard(bus, 0x61)
        fake.fault("unplug=true")
        with pytest.raises(can.CanOperationError):
            heard(bus, 0x555)
        with contextlib.suppress(can.CanOperationError):
            bus.shutdown()
        bus.serialPortOrig.close()
        assert not link.is_symlink()
        assert unplugged(tcp(fake.ready_line[1]))
        fake.fault("unplug=false")
        for place in (serial(fake.ready_line[0]), tcp(fake.ready_line[1])):
            with opened(place) as again:
                heard(again, 0x61)


def test_link_never_replaces_a_file(tmp_path, capsys):
    existing = tmp_path / "file"
    existing.write_text("kept")
    assert main(["lfield_sim.can:SIM", "--listen", f"slcan-pty:{existing}"]) == 69
    assert existing.read_text() == "kept"
    assert "exists" in capsys.readouterr().err


def test_fake_ends_when_its_stdin_closes(capfd):
    with running_fake("can", *BOTH) as fake:
        out, _ = fake.process.communicate(timeout=60)
        assert (out, capfd.readouterr().err, fake.process.returncode) == ("", "", 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_the_fake(number):
    with running_fake("can", "--device", "cia402:1") as fake:
        fake.process.send_signal(number)
        assert fake.process.wait(60) == 0


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (("--listen", "udp:127.0.0.1:0"), 64, "cannot listen"),
        (("--device", "cia402:5", "--device", "odrive:5"), 64, "same node id"),
        (("--fault", "loss=2"), 64, "from 0 to 1"),
        (("--fault", "loss@9=1", "--device", "cia402:5"), 64, "no device '9'"),
        (("--bitrate", "7"), 2, "--bitrate: must be"),
    ],
)
def test_invalid_command_line_is_an_error_without_traceback(options, status, words):
    command = [sys.executable, "-m", "lfield.driver.sims", "lfield_sim.can:SIM", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.returncode) == ("", status)
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_port_in_use_is_an_error(capsys):
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        port = occupied.getsockname()[1]
        assert main(["lfield_sim.can:SIM", "--listen", f"socketcand:127.0.0.1:{port}"]) == 69
    assert "in use" in capsys.readouterr().err


def binding(field: str, kind: str, **options) -> DeviceBinding:
    place = {"agent": "a", "field": field, "driver": "can", "endpoint": "e", "safe_state": "brake"}
    return DeviceBinding(type=kind, options=options, **place)


def test_binding_that_cannot_be_simulated_is_refused():
    with pytest.raises(UsageError, match=r"a\.winch: .* counts per second"):
        SIM.arguments([binding("winch", "CanAxis", protocol="cia402", node=5, velocity_unit="rpm")])


def test_simulated_bus_is_made_from_bindings():
    assert isinstance(SIM, Sim)
    devices = [
        binding("winch", "CanAxis", protocol="cia402", node=5, counts=4096),
        binding("spare", "CanAxis", protocol="cia402", node=5, counts=4096),
        binding("wheel", "CanAxis", protocol="odrive", node=3, counts=0),
        binding("grip", "CanSignals", dbc=str(GRIPPER), commands=["GripperCommand"]),
    ]
    assert SIM.arguments(devices) == [
        *("--listen", "socketcand:127.0.0.1:0"),
        *("--device", "cia402:5:a.winch,counts=4096"),
        *("--device", "odrive:3:a.wheel"),
        *("--device", f"dbc:{GRIPPER}:a.grip,commands=GripperCommand"),
    ]
    with running_fake("can", *SIM.arguments(devices)) as fake:
        assert fake.ready_line[1:] == ["cia402:5", "odrive:3", "dbc:gripper"]


@pytest.mark.parametrize("text", ["", "slcan", "socketcand:127.0.0.1", "socketcand::1", "socketcand:a:99999"])
def test_invalid_listen_endpoint_is_refused(text):
    with pytest.raises(UsageError, match="cannot listen"):
        parse_listen(text)
