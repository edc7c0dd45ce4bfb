"""MAVLink FTP against a scripted server: bursts with gaps, refusals, session ends."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_peer import Channel, run

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.file_packets import DATA, PACKET, NakCode, Opcode, Packet, crc32, decode, entries
from lfield_mavlink.services.file_transfer import MAX_FILE, FileTransfer, Pieces

TO_US = (255, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)


class Server:
    """One session, like PX4. `unknown` opcodes are refused; `burst` packets make a burst."""

    def __init__(self, files=None, *, unknown=(Opcode.LIST_WITH_TIME,), burst=5) -> None:
        self.files: dict[str, bytes] = dict(files or {})
        self.unknown, self.burst = unknown, burst
        self.session: str | None = None
        self.resets = 0
        self.last: tuple[int, list] | None = None
        self.asked: list[int] = []
        self.breaks_writes = False

    def __call__(self, message):
        if message.get_type() != "FILE_TRANSFER_PROTOCOL":
            return []
        request = decode(message.payload)
        if self.last is not None and self.last[0] == request.sequence:
            return self.last[1]
        self.asked.append(request.opcode)
        answers = [
            dialect.MAVLink_file_transfer_protocol_message(0, *TO_US, packet.encode())
            for packet in self.answer(request)
        ]
        self.last = (request.sequence, answers)
        return answers

    def ack(self, request, data=b"", *, number=1, offset=0, complete=False):
        sequence = (request.sequence + number) % 0x10000
        return Packet(
            sequence, Opcode.ACK, request.session, len(data), offset, data, request.opcode, complete
        )

    def nak(self, request, *code):
        data = bytes(code)
        sequence = (request.sequence + 1) % 0x10000
        return Packet(sequence, Opcode.NAK, request.session, len(data), 0, data, request.opcode)

    def answer(self, request):
        if request.opcode in self.unknown:
            return [self.nak(request, NakCode.UNKNOWN_COMMAND)]
        handler = getattr(self, "on_" + Opcode(request.opcode).name.lower())
        return handler(request)

    def on_reset(self, request):
        self.resets += 1
        self.session = None
        return [self.ack(request)]

    def on_terminate(self, request):
        self.session = None
        return [self.ack(request)]

    def opened(self, request, path, data):
        if self.session is not None:
            return [self.nak(request, NakCode.NO_SESSIONS)]
        self.session = path
        return [self.ack(request, data)]

    def on_open_read(self, request):
        path = request.data.decode()
        if path not in self.files:
            return [self.nak(request, NakCode.NOT_FOUND)]
        return self.opened(request, path, len(self.files[path]).to_bytes(4, "little"))

    def on_create(self, request):
        self.files[request.data.decode()] = b""
        return self.opened(request, request.data.decode(), b"")

    def on_write(self, request):
        if self.breaks_writes:
            return [self.nak(request, NakCode.FAIL_ERRNO, 28)]
        data = self.files[self.session]
        self.files[self.session] = data[: request.offset].ljust(request.offset, b"\0") + request.data
        return [self.ack(request)]

    def on_read(self, request):
        data = self.files[self.session][request.offset : request.offset + request.size]
        return [self.ack(request, data)] if data else [self.nak(request, NakCode.END_OF_FILE)]

    def on_burst_read(self, request):
        data, packets = self.files[self.session], []
        for number in range(self.burst):
            start = request.offset + number * DATA
            if start >= len(data):
                break
            complete = number == self.burst - 1
            piece = data[start : start + DATA]
            packets.append(self.ack(request, piece, number=number + 1, offset=start, complete=complete))
        return packets or [self.nak(request, NakCode.END_OF_FILE)]

    def on_crc32(self, request):
        return [self.ack(request, crc32(self.files[request.data.decode()]).to_bytes(4, "little"))]

    def on_list(self, request):
        names = [f"F{path.lstrip('/')}\t{len(data)}" for path, data in sorted(self.files.items())]
        names = ["Dlogs", "S", *names][request.offset :]
        data = b""
        for name in names:
            if len(data) + len(name) + 1 > 60:
                break
            data += name.encode() + b"\0"
        return [self.ack(request, data)] if data else [self.nak(request, NakCode.END_OF_FILE)]

    def on_list_with_time(self, request):
        return [self.nak(request, NakCode.FAIL)]

    def on_remove(self, request):
        found = self.files.pop(request.data.decode(), None)
        return [self.nak(request, NakCode.NOT_FOUND) if found is None else self.ack(request)]

    def on_make_folder(self, request):
        return [self.nak(request, NakCode.EXISTS)]


def joined(server, **faults):
    channel = Channel(server, **faults)
    return channel, FileTransfer(channel)


BIG = bytes(range(256)) * 40


@pytest.mark.parametrize("unknown", [(), (Opcode.BURST_READ,), (Opcode.CRC32, Opcode.LIST_WITH_TIME)])
@pytest.mark.parametrize("data", [b"", b"x", b"y" * DATA, BIG], ids=["empty", "one", "packet", "big"])
def test_file_is_written_and_read(unknown, data):
    server = Server(unknown=unknown)
    _, files = joined(server)

    async def scenario():
        await files.write("/a", data)
        return await files.read("/a")

    assert run(scenario(), 60.0) == data
    assert server.session is None
    assert server.resets == 1


@pytest.mark.parametrize("seed", range(12))
def test_gaps_of_a_burst_are_filled_by_single_reads(seed):
    server = Server({"/a": BIG}, burst=1000)
    _, files = joined(server, seed=seed, loss=0.2, repeat=0.2, overtake=0.2)
    assert run(files.read("/a"), 200.0) == BIG


def test_complete_burst_needs_no_single_reads():
    server = Server({"/a": BIG}, burst=1000)
    _, files = joined(server)
    run(files.read("/a"), 5.0)
    assert Opcode.READ not in server.asked
    assert server.asked.count(Opcode.BURST_READ) == 1


@pytest.mark.parametrize("unknown", [(), (Opcode.LIST_WITH_TIME,)])
def test_folder_is_listed_by_a_supported_request(unknown):
    server = Server({f"/file{number:02}.txt": b"12345" for number in range(30)}, unknown=unknown)
    _, files = joined(server)
    found = run(files.list_folder("/"), 60.0)
    assert [(e.name, e.folder, e.size) for e in found[:2]] == [("logs", True, 0), ("file00.txt", False, 5)]
    assert len(found) == 31


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda files: files.read("/nope"), "reading /nope refused: no such file"),
        (lambda files: files.remove("/nope"), "removing /nope refused: no such file"),
        (lambda files: files.make_folder("/a"), "making /a refused: it already exists"),
        (lambda files: files.read(""), "is not a path"),
        (lambda files: files.read("/" + "x" * 200), "is not a path"),
        (lambda files: files.read("/a\0b"), "is not a path"),
        (lambda files: files.read("/big", 100), "10240 bytes exceed the limit of 100"),
        (lambda files: files.write("/a", bytes(MAX_FILE + 1)), "exceed the limit"),
    ],
)
def test_refusal_names_path_and_reason_and_ends_the_session(ask, words):
    server = Server({"/a": b"1", "/big": BIG})
    _, files = joined(server)

    async def scenario():
        with pytest.raises(DeviceError, match=words):
            await ask(files)
        await asyncio.sleep(1.0)
        # The session has ended, so the next transfer can use it.
        return await files.read("/a")

    assert run(scenario(), 30.0) == b"1"


def test_full_card_is_reported_and_ends_the_session():
    server = Server()
    server.breaks_writes = True
    _, files = joined(server)

    async def scenario():
        with pytest.raises(DeviceError, match=r"No space left on device \(errno 28\)"):
            await files.write("/a", b"data")
        await asyncio.sleep(0.1)

    run(scenario(), 10.0)
    assert server.session is None


def test_checksum_mismatch_is_an_error():
    server = Server({"/a": b"right"})
    server.on_crc32 = lambda request: [server.ack(request, (1).to_bytes(4, "little"))]
    _, files = joined(server)
    with pytest.raises(DeviceError, match="differs from what was transferred"):
        run(files.read("/a"), 5.0)


@pytest.mark.parametrize("announced", [100_000, 1 << 22])
@pytest.mark.parametrize("seed", range(4))
def test_generated_file_is_read_to_its_real_end(announced, seed):
    """As measured on ArduPilot: @PARAM/param.pck announced 15996 bytes and had 14701, wrong checksum."""
    server = Server({"@SYS/uarts.txt": BIG}, burst=1000)
    server.on_crc32 = lambda request: [server.ack(request, (1).to_bytes(4, "little"))]
    opened = server.opened
    server.opened = lambda request, path, data: opened(request, path, announced.to_bytes(4, "little"))
    _, files = joined(server, seed=seed, loss=0.2 if seed else 0.0)

    async def scenario():
        with pytest.raises(DeviceError, match="exceeds the limit of 100 bytes"):
            await files.read("@SYS/uarts.txt", 100)
        return await files.read("@SYS/uarts.txt", 256 * 1024)

    assert run(scenario(), 200.0) == BIG


@pytest.mark.parametrize("refusal", [NakCode.FAIL, NakCode.NO_SESSIONS])
def test_refused_open_explains_the_single_session(refusal):
    server = Server({"/a": b"1"})
    server.opened = lambda request, path, data: [server.nak(request, refusal)]
    _, files = joined(server)
    with pytest.raises(DeviceError, match="only one file can be open, perhaps by another client"):
        run(files.read("/a"), 5.0)


def test_next_transfer_resets_a_session_that_could_not_end():
    server = Server({"/a": b"1", "/big": BIG})
    end, server.on_terminate = server.on_terminate, lambda request: []
    _, files = joined(server)

    async def scenario():
        with pytest.raises(DeviceError, match="exceed the limit of 100"):
            await files.read("/big", 100)
        server.on_terminate = end
        assert await files.read("/a") == b"1"

    run(scenario(), 20.0)
    assert server.resets == 2


def test_cancelled_read_ends_its_session():
    server = Server({"/a": BIG}, burst=1, unknown=())
    _, files = joined(server)

    async def scenario():
        task = asyncio.get_running_loop().create_task(files.read("/a"))
        await asyncio.sleep(0.1)
        assert server.session == "/a"
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await asyncio.sleep(0.1)
        assert server.session is None
        return await files.read("/a")

    assert run(scenario(), 10.0) == BIG


def test_silent_server_is_an_error_within_5_seconds():
    files = FileTransfer(Channel(lambda message: []))
    with pytest.raises(DeviceError, match="did not answer") as raised:
        run(files.read("/a"), 5.01)
    assert raised.value.kind == "DeviceTimeoutException"


def test_endless_folder_listing_is_an_error():
    def answer(message):
        request = decode(message.payload)
        data = b"Fx\t1\0" * 20 if request.opcode == Opcode.LIST_WITH_TIME else b""
        packet = Packet((request.sequence + 1) % 0x10000, Opcode.ACK, 0, len(data), 0, data, request.opcode)
        return [dialect.MAVLink_file_transfer_protocol_message(0, *TO_US, packet.encode())]

    with pytest.raises(DeviceError, match="more than 5000 entries"):
        run(FileTransfer(Channel(answer)).list_folder("/"), 60.0)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.integers(0, 255), max_size=300))
def test_any_payload_is_decoded_or_rejected(payload):
    packet = decode(payload)
    if packet is None:
        assert len(payload) != PACKET or payload[4] > DATA
        return
    assert decode(packet.encode()) == packet
    entries(packet.data)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=DATA))
def test_any_listing_gives_a_bounded_number_of_entries(data):
    found, used = entries(data)
    assert len(found) <= used <= len(data)
    assert all(entry.size >= 0 for entry in found)


@pytest.mark.few(0)
@settings(max_examples=15, deadline=None)
@given(st.binary(min_size=PACKET, max_size=PACKET), st.integers(0, 15), st.booleans())
def test_random_server_answers_end_in_bounded_time(noise, opcode, right_number):
    """Answers with a correct number and wrong contents give a result or a declared error in bounded time."""

    def answer(message):
        request = decode(message.payload)
        payload = bytearray(noise)
        if right_number:
            payload[0:2] = ((request.sequence + 1) % 0x10000).to_bytes(2, "little")
            payload[3], payload[5] = 128 + opcode % 2, request.opcode
            payload[4] %= DATA + 1
            payload[14:16] = b"\0\0"
        return [dialect.MAVLink_file_transfer_protocol_message(0, *TO_US, list(payload))]

    async def scenario():
        for work in (
            lambda f: f.read("/a", 300),
            lambda f: f.list_folder("/"),
            lambda f: f.write("/a", b"x"),
        ):
            try:
                await work(FileTransfer(Channel(answer)))
            except DeviceError:
                continue

    run(scenario(), 200.0)


@given(st.integers(0, 200), st.lists(st.tuples(st.integers(0, 300), st.binary(max_size=80)), max_size=20))
def test_pieces_stay_within_the_size_and_find_the_first_gap(size, pieces):
    file, have = Pieces(size), set()
    for start, piece in pieces:
        file.put(start, piece)
        have |= set(range(start, min(start + len(piece), size)))
    gap = file.first_gap()
    assert (gap is None) == (len(have) == size)
    if gap is not None:
        assert gap[0] == min(set(range(size)) - have)
        assert len(file.until_gap()) == gap[0]
