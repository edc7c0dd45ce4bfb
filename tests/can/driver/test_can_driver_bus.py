"""The bus: interfaces of python-can with real threads that fail, fill up, send invalid data and return."""

from __future__ import annotations

import asyncio
import errno
import os
import pty
import socket
import threading
import time
import tty
from contextlib import suppress

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loopback import own_address

from lfield.errors import DeviceError
from lfield_can.bus import connection, socketcand
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.connection import lock_tty
from lfield_can.bus.frames import Frame, Listener
from lfield_can.bus.socketcand import Socketcand

# python-can leaves the socket of a failed opening to the garbage collector.
pytestmark = pytest.mark.filterwarnings(
    "ignore:Exception ignored in. <socket.socket:pytest.PytestUnraisableExceptionWarning"
)


class BusBench:
    """A bus, with the frames and notes that it reports."""

    def __init__(self, endpoint: str) -> None:
        self.frames: list[Frame] = []
        self.notes: list[str] = []
        self.bus = Bus(endpoint, self.frames.append, self.notes.append)

    async def until(self, condition, bound=60.0):
        end = time.monotonic() + bound
        while not condition():
            assert time.monotonic() < end, f"condition not met; notes: {self.notes}"
            await asyncio.sleep(0.01)

    def noted(self, words: str) -> bool:
        return any(words in note for note in self.notes)


def run(endpoint, scenario):
    async def main():
        bench = BusBench(endpoint)
        await bench.bus.open()
        try:
            return await scenario(bench)
        finally:
            await bench.bus.close()

    return asyncio.run(main())


class Server:
    """A minimal socketcand server. It sends `words` in turn; an empty one closes the connection."""

    def __init__(self, port: int = 0, *, words=(b"< hi >", b"< ok >", b"< ok >"), after: bytes = b"") -> None:
        self.listener = socket.create_server((own_address(), port))
        self.port, self.words, self.after = self.listener.getsockname()[1], words, after
        self.endpoint = f"socketcand:{own_address()}:{self.port}/can0"
        self.peers: list[socket.socket] = []
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self) -> None:
        while True:
            try:
                peer, _ = self.listener.accept()
            except OSError:
                return
            self.peers.append(peer)
            threading.Thread(target=self.greet, args=(peer,), daemon=True).start()

    def greet(self, peer: socket.socket) -> None:
        for number, word in enumerate(self.words):
            if number:
                peer.recv(256)
            if not word:
                peer.shutdown(socket.SHUT_RDWR)
                return
            peer.sendall(word + (self.after if number == 2 else b""))

    def stop(self) -> None:
        with suppress(OSError):  # without shutdown, close() lets a blocked accept() continue
            self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        for peer in self.peers:
            peer.close()


@pytest.fixture
def server():
    server = Server()
    yield server
    server.stop()


class Stub(can.BusABC):
    """An interface that calls `send` of the test for each frame, and fails while `gone` is set."""

    def __init__(self, send) -> None:
        super().__init__(channel="stub")
        self.pending: list[can.Message] = []
        self.sent: list[can.Message] = []
        self.on_send = send
        self.gone = False

    def _recv_internal(self, timeout):
        if self.gone:
            raise can.CanOperationError("pulled out")
        if self.pending:
            return self.pending.pop(0), True
        time.sleep(0.01)
        return None, True

    def send(self, msg, timeout=None):
        self.on_send(self, msg)
        self.sent.append(msg)


@pytest.fixture
def stub(monkeypatch):
    """Make the next buses stubs; returns the list of the stubs that were opened."""
    stubs: list[Stub] = []

    def install(send=lambda bus, message: None):
        def make(**_):
            stubs.append(Stub(send))
            return stubs[-1]

        monkeypatch.setattr(connection.can, "Bus", make)
        return stubs

    return install


def test_frames_are_sent_and_received():
    async def scenario(bench):
        with can.Bus(interface="virtual", channel="frames") as other:
            await bench.bus.send(Frame(0x123, b"\1\2"))
            await bench.bus.send(Frame(0x123, b"", extended=True))
            first, second = other.recv(60.0), other.recv(60.0)
            assert (first.arbitration_id, bytes(first.data), first.is_extended_id) == (0x123, b"\1\2", False)
            assert second.is_extended_id
            other.send(can.Message(arbitration_id=0x321, is_remote_frame=True, is_extended_id=False))
            other.send(can.Message(arbitration_id=0x321, data=b"\7", is_extended_id=False))
            await bench.until(lambda: bench.frames)
        assert bench.frames == [Frame(0x321, b"\7")]

    run("virtual:frames", scenario)


def test_error_frames_are_counted_and_noted_at_intervals(stub):
    made = stub()

    async def scenario(bench):
        made[0].pending += [
            can.Message(arbitration_id=0x08, is_error_frame=True, data=b"\0") for _ in range(50)
        ]
        await bench.until(lambda: bench.bus.errors == 50)
        (note,) = bench.notes
        assert note.code == "can-error-frames"
        assert note.startswith("error frames on virtual:x (count 1): protocol violation; check terminators")

    run("virtual:x", scenario)


def test_bus_off_reopens_the_interface(stub):
    made = stub()

    async def scenario(bench):
        made[0].pending.append(can.Message(arbitration_id=0x40, is_error_frame=True, data=b"\0"))
        await bench.until(lambda: bench.noted("link opened: "))
        assert bench.notes == ["link lost: virtual:x: bus off", "link opened: virtual:x"]
        await bench.bus.send(Frame(1))
        assert [m.arbitration_id for m in made[1].sent] == [1]

    run("virtual:x", scenario)


def test_controller_states_and_the_cause_of_bus_off_are_noted(stub):
    made = stub()

    def error(identifier, data=b""):
        return can.Message(arbitration_id=identifier, is_error_frame=True, data=data)

    async def scenario(bench):
        made[0].pending += [error(0x20), error(0x04, b"\0\x20"), error(0x04, b"\0\x40")]
        await bench.until(lambda: bench.bus.errors == 3)
        assert bench.bus.problem_text == ""
        made[0].pending += [error(0x20), error(0x04, b"\0\x20"), error(0x40)]
        await bench.until(lambda: bench.noted("link opened: "))
        # The interface is open again, but no frame was received yet: its controller may still be off.
        assert bench.bus.problem_text.startswith(
            "bus off: no acknowledgement of a frame; check that another node"
        )
        made[1].pending.append(can.Message(arbitration_id=7, is_extended_id=False))
        await bench.until(lambda: bench.frames)
        assert bench.bus.problem_text == ""
        codes = [getattr(note, "code", "") for note in bench.notes]
        assert codes == [
            "can-error-frames",
            "can-bus-state",
            "can-bus-active",
            "can-bus-state",
            "endpoint-lost",
            "endpoint-reopened",
            "can-bus-active",
        ]
        assert bench.noted("link lost: virtual:x: bus off (no acknowledgement of a frame; check that another")

    run("virtual:x", scenario)


def test_pcan_reports_bus_off_by_its_status(stub):
    made = stub()

    async def scenario(bench):
        made[0].status = lambda: 0x10
        made[0].pending.append(can.Message(arbitration_id=4, is_error_frame=True, data=b"\0\x19\0\0"))
        await bench.until(
            lambda: bench.noted("link lost: pcan:USB: bus off (protocol violation (bit stuffing")
        )

    run("pcan:USB", scenario)


def test_failed_interface_is_reopened(stub):
    made = stub()

    async def scenario(bench):
        made[0].gone = True
        await bench.until(lambda: bench.noted("link lost"))
        with pytest.raises(DeviceError, match="the bus is lost") as error:
            await bench.bus.send(Frame(1))
        assert error.value.kind == "DeviceTimeoutException"
        await bench.until(lambda: bench.noted("link opened: "))
        made[1].pending.append(can.Message(arbitration_id=7, is_extended_id=False))
        await bench.until(lambda: bench.frames)

    run("virtual:x", scenario)


def test_closed_server_is_detected_at_once_without_cpu_load(server):
    async def scenario(bench):
        server.stop()
        await bench.until(lambda: bench.noted(": the server has closed the connection"))
        used = time.process_time()
        await asyncio.sleep(1.0)
        assert time.process_time() - used < 0.5  # python-can's own loop would use all of it
        again = Server(server.port)
        try:
            await bench.until(lambda: bench.noted("link opened: "))
            again.peers[-1].sendall(b"< frame 123 0.0 0102 >")
            await bench.until(lambda: bench.frames)
            assert bench.frames == [Frame(0x123, b"\1\2")]
        finally:
            again.stop()

    run(server.endpoint, scenario)


def test_malformed_socketcand_text_is_counted_and_the_rest_is_read(server):
    nonsense = [
        b"< frame xyz 0.0 >", b"< frame 800 0.0 00 >", b"< frame 1 0.0 000102030405060708 >", b"< error >",
        b"< frame 001 0.0 F >", b"x >", b"<" * 1000,
    ]  # fmt: skip

    async def scenario(bench):
        peer = server.peers[-1]
        for text in nonsense[:-1]:
            peer.sendall(text)
        peer.sendall(b"< frame 001 0.0 FF >< frame 00000002 0.0 >< error 008 0.0 ><frame 0")
        await bench.until(lambda: len(bench.frames) == 2)
        peer.sendall(b"03 0.0 0102>")
        await bench.until(lambda: len(bench.frames) == 3)
        assert bench.frames == [Frame(1, b"\xff"), Frame(2, b"", extended=True), Frame(3, b"\1\2")]
        assert bench.bus.errors == 1
        peer.sendall(nonsense[-1])
        await bench.until(lambda: bench.bus.malformed == len(nonsense))
        peer.sendall(b"< frame 004 0.0 >")
        await bench.until(lambda: len(bench.frames) == 4)
        assert not bench.noted("link lost")

    run(server.endpoint, scenario)


@settings(deadline=None)
@given(
    st.lists(
        st.one_of(st.binary(max_size=300), st.text("<> framerot0123456789ABF.", max_size=60).map(str.encode))
    )
)
def test_socketcand_client_survives_any_bytes(pieces):
    frames = []
    client = Socketcand(Listener(frames.append, lambda identifier, data: None, pytest.fail))
    client._answers = None
    for piece in pieces:
        client.data_received(piece)
        assert len(client._unread) <= socketcand.LONGEST
    client.data_received(b"><frame 123 0.0 01>")
    assert frames[-1] == Frame(0x123, b"\1")
    assert all(frame.id < 1 << 29 and len(frame.data) <= 8 for frame in frames)


def test_frames_are_sent_in_socketcand_syntax(server):
    async def scenario(bench):
        peer = server.peers[-1]
        await bench.bus.send(Frame(0x12, bytes([1, 0xAB])))
        bench.bus.post(Frame(0x34, b"", extended=True))
        with pytest.raises(DeviceError, match="does not support CAN FD"):
            await bench.bus.send(Frame(1, bytes(16), fd=True))
        expected, got = b"< send 012 2 01 ab >< send 00000034 0  >", b""
        while len(got) < len(expected):
            got += await asyncio.to_thread(peer.recv, 256)
        assert got == expected

    run(server.endpoint, scenario)


def test_server_that_does_not_read_gives_a_full_send_queue(server):
    async def scenario(bench):
        for _ in range(1_000_000):
            await bench.bus.send(Frame(1, bytes(8)))

    with pytest.raises(DeviceError, match="the send queue is full"):
        run(server.endpoint, scenario)


def test_answer_and_frame_in_one_segment_are_both_read():
    server = Server(after=b"< frame 005 1.2 00 >")

    async def scenario(bench):
        await bench.until(lambda: bench.frames)
        assert bench.frames == [Frame(5, b"\0")]
        assert bench.bus.malformed == 0

    try:
        run(server.endpoint, scenario)
    finally:
        server.stop()


@pytest.mark.parametrize(
    ("words", "reason"),
    [((b"< no >",), "the server says 'no'"), ((b"< hi >", b""), "the server says 'nothing'")],
)
def test_refusal_by_the_server_is_an_error(words, reason):
    server = Server(words=words)

    async def scenario(bench):
        raise AssertionError("the device must not be opened")

    try:
        with pytest.raises(DeviceError, match=rf"cannot open socketcand:.*{reason}"):
            run(server.endpoint, scenario)
    finally:
        server.stop()


def test_silent_server_is_an_error_within_its_time(monkeypatch):
    connected = socketcand.connected
    monkeypatch.setattr(socketcand, "connected", lambda lookup, _, make: connected(lookup, 60.0, make))
    monkeypatch.setattr(socketcand, "ANSWER", 0.3)
    mute = Server(words=())

    async def scenario(bench):
        raise AssertionError("the device must not be opened")

    try:
        with pytest.raises(DeviceError, match=r"cannot open socketcand:.*no greeting within 0.3 s"):
            run(mute.endpoint, scenario)
    finally:
        mute.stop()


async def _must_not_open(bench):
    raise AssertionError("the device must not be opened")


@pytest.mark.parametrize(
    ("endpoint", "reason"),
    [
        ("socketcand:127.0.0.1:1/can0", ""),
        ("slcan:/dev/nothing-here", ""),
        # This kernel has no SocketCAN, or no such interface.
        ("socketcan:nothing0", ".*(sudo modprobe can_raw|ip link)"),
    ],
)
def test_missing_interface_is_an_error_at_once(endpoint, reason):
    with pytest.raises(DeviceError, match=f"cannot open {reason}"):
        run(endpoint, _must_not_open)


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.EACCES, "no permission; 'sudo usermod -aG .*then log in again"),
        # The remedies of SocketCAN are not those of a serial adapter.
        (errno.ENODEV, "No such device$"),
    ],
)
def test_an_adapter_that_cannot_be_opened_is_reported_with_its_reason(number, reason, monkeypatch):
    def refused(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("lfield_can.bus.connection.os.open", refused)
    with pytest.raises(DeviceError, match=reason):
        lock_tty("/dev/ttyACM7")


@pytest.fixture
def adapter():
    """The adapter's side of a pty, and the path and descriptor of the other side."""
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    os.set_blocking(master, False)
    yield master, os.ttyname(slave), slave
    for fd in (master, slave):
        with suppress(OSError):  # the test may have closed it already
            os.close(fd)


def test_serial_port_in_use_is_refused(adapter):
    _, path, _ = adapter

    async def scenario(bench):
        with pytest.raises(DeviceError, match="is in use by another program; a serial port has one owner"):
            await BusBench(f"slcan:{path}").bus.open()

    run(f"slcan:{path}", scenario)
    run(f"slcan:{path}", lambda bench: asyncio.sleep(0))


def test_adapter_that_never_ends_a_line_is_closed(adapter, monkeypatch):
    monkeypatch.setattr(connection, "LONGEST_LINE", 64)
    master, path, _ = adapter

    async def scenario(bench):
        os.write(master, b"t" * 100)
        await bench.until(lambda: bench.noted(": the received data is not CAN frames"))

    run(f"slcan:{path}", scenario)


def test_slcan_adapter_sends_receives_and_is_unplugged(adapter):
    master, path, slave = adapter

    async def scenario(bench):
        os.write(master, b"\rz\rt1232AABB\rnonsense\rtXYZ\rT000001231FF\r")
        await bench.until(lambda: len(bench.frames) == 2)
        assert bench.frames == [Frame(0x123, b"\xaa\xbb"), Frame(0x123, b"\xff", extended=True)]
        assert bench.bus.malformed >= 1
        await bench.bus.send(Frame(0x321, b"\1"))
        written = b""
        while b"t321101\r" not in written:
            # The kernel passes terminal input on in a thread of its own.
            with suppress(BlockingIOError):
                written += os.read(master, 4096)
            await asyncio.sleep(0.01)
        os.close(slave)
        os.close(master)
        await bench.until(lambda: bench.noted("link lost"))

    run(f"slcan:{path}", scenario)
