"""The fake's file server by payloads: operations, refusals, bursts, lost replies, random requests."""

from __future__ import annotations

import struct
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield_sim.mavlink.services.file_tree import MAX_ENTRIES, MAX_FILE, FileTree, FtpError, GeneratedFile
from lfield_sim.mavlink.services.ftp import (
    ACK,
    ARDUPILOT,
    DATA,
    MAX_SESSIONS,
    NAK,
    PAYLOAD,
    PX4,
    FtpOpcode,
    FtpPacket,
    FtpServer,
    ftp_crc32,
)

PEER = (255, 190)
LOG = bytes(range(256)) * 100


class Client:
    """A client of the file server."""

    def __init__(self, server=None, peer=PEER):
        self.server = server or FtpServer(FileTree({"/a/log.bin": LOG, "/a/one.txt": b"1", "/b.txt": b""}))
        self.peer, self.number = peer, 0

    def ask(self, opcode, path=b"", *, session=0, offset=0, size=None, data=None):
        content = data if data is not None else path.encode() if isinstance(path, str) else path
        self.number += 2
        request = FtpPacket(
            self.number, session, opcode, len(content) if size is None else size, 0, 0, offset, content
        )
        return self.send(request)

    def send(self, request):
        replies = self.server.receive(self.peer, request.write())
        assert all(len(reply) == PAYLOAD for reply in replies)
        if not replies:
            return None
        (reply,) = map(FtpPacket.read, replies)
        assert (reply.number, reply.request_opcode) == (request.number + 1, request.opcode)
        return reply

    def refused(self, *arguments, **options):
        reply = self.ask(*arguments, **options)
        assert reply.opcode == NAK
        return FtpError(reply.data[0])

    def ok(self, *arguments, **options):
        reply = self.ask(*arguments, **options)
        assert reply.opcode == ACK, reply
        return reply

    def listing(self, path):
        entries = []
        while True:
            reply = self.ask(FtpOpcode.LIST, path, offset=len(entries))
            if reply.opcode == NAK:
                assert reply.data[0] == FtpError.EOF
                return entries
            entries += reply.data.rstrip(b"\0").decode().split("\0")


def test_large_folder_is_listed_in_pieces():
    names = [f"/many/file{n:04}.bin" for n in range(100)]
    c = Client(FtpServer(FileTree(dict.fromkeys(names, b"12345"), {})))
    assert c.listing("/many") == [f"Ffile{n:04}.bin\t5" for n in range(100)]
    assert c.listing("/") == ["Dmany"]
    assert c.listing("") == ["Dmany"]
    assert c.refused(FtpOpcode.LIST, "/nowhere") is FtpError.NOT_FOUND


def test_folder_listing_has_the_dot_entries_of_each_autopilot():
    ardupilot = Client(
        FtpServer(FileTree({"/f": b"1"}, listings={"@SYS": ["Fx\t9"]}, dots=("D.", "D..")), ARDUPILOT)
    )
    assert ardupilot.ok(FtpOpcode.LIST, "/").data == b"D.\0\0D..\0\0Ff\t1\0\0D@SYS\0\0"
    assert ardupilot.ok(FtpOpcode.LIST, "/", offset=3).data == b"D@SYS\0\0"
    px4 = Client(FtpServer(FileTree({"/f": b"1"}, dots=("S", "S")), PX4))
    assert px4.ok(FtpOpcode.LIST, "/").data == b"S\0S\0Ff\t1\0"
    px4.ok(FtpOpcode.MAKE_FOLDER, "/new")
    px4.ok(FtpOpcode.REMOVE_FOLDER, "/new")


def test_file_is_read_in_pieces_until_its_end():
    c = Client()
    opened = c.ok(FtpOpcode.OPEN_READ, "/a/log.bin", session=3)
    assert struct.unpack("<I", opened.data) == (len(LOG),)
    content = b""
    while True:
        reply = c.ask(FtpOpcode.READ, session=opened.session, offset=len(content), size=DATA)
        if reply.opcode == NAK:
            break
        assert reply.offset == len(content)
        content += reply.data
    assert reply.data[0] == FtpError.EOF
    assert content == LOG
    assert c.ok(FtpOpcode.READ, session=opened.session, offset=5, size=7).data == LOG[5:12]
    c.ok(FtpOpcode.TERMINATE, session=opened.session)
    assert c.refused(FtpOpcode.READ, session=opened.session, size=DATA) is FtpError.INVALID_SESSION


def test_burst_is_sent_in_steps_with_pauses_and_an_end():
    c = Client()
    session = c.ok(FtpOpcode.OPEN_READ, "/a/log.bin").session
    content, pauses, over = b"", [], False
    while not over:
        assert c.ask(FtpOpcode.BURST_READ, session=session, offset=len(content), size=80) is None
        while packets := [FtpPacket.read(payload) for _, payload in c.server.advance()]:
            assert len(packets) <= 10
            pieces = [p for p in packets if p.opcode == ACK]
            assert [p.offset for p in pieces] == [len(content) + 80 * i for i in range(len(pieces))]
            content += b"".join(p.data for p in pieces)
            pauses += [len(content) for p in pieces if p.burst_over]
            over = packets[-1].opcode == NAK
    assert content == LOG
    assert pauses == [200 * 80]


def test_last_packet_of_a_burst_reports_end_of_file():
    c = Client()
    session = c.ok(FtpOpcode.OPEN_READ, "/a/one.txt").session
    c.ask(FtpOpcode.BURST_READ, session=session, size=DATA)
    first, last = [FtpPacket.read(payload) for _, payload in c.server.advance()]
    assert (first.opcode, first.data, first.burst_over) == (ACK, b"1", 0)
    assert (last.opcode, last.data[0], last.burst_over) == (NAK, FtpError.EOF, 0)
    assert last.number == first.number + 1
    assert c.server.advance() == []
    assert c.refused(FtpOpcode.BURST_READ, session=session, offset=1, size=DATA) is FtpError.EOF


def test_file_is_created_written_checked_and_removed():
    c = Client()
    session = c.ok(FtpOpcode.CREATE, "/a/new.txt", session=1).session
    data = b"hello " * 100
    for offset in range(0, len(data), DATA):
        c.ok(FtpOpcode.WRITE, session=session, offset=offset, data=data[offset : offset + DATA])
    c.ok(FtpOpcode.TERMINATE, session=session)
    crc = struct.unpack("<I", c.ok(FtpOpcode.CRC32, "/a/new.txt").data)[0]
    assert crc == ftp_crc32(data)
    assert "Fnew.txt\t600" in c.listing("/a")
    session = c.ok(FtpOpcode.OPEN_WRITE, "/a/new.txt", session=1).session
    c.ok(FtpOpcode.WRITE, session=session, offset=602, data=b"!")
    assert c.refused(FtpOpcode.READ, session=session, size=5) is FtpError.FAIL
    assert c.server.tree.read("/a/new.txt") == data + b"\0\0!"
    c.ok(FtpOpcode.REMOVE, "/a/new.txt")
    assert c.refused(FtpOpcode.OPEN_READ, "/a/new.txt") is FtpError.NOT_FOUND
    assert c.refused(FtpOpcode.CRC32, "/a/new.txt") is FtpError.NOT_FOUND


def test_checksum_is_crc32_without_inversions():
    # The CRC-32 of zlib without its inversions: initial value 0, no final XOR.
    register = 0
    for byte in b"123456789":
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)
    assert ftp_crc32(b"123456789") == register != zlib.crc32(b"123456789")


def test_folder_is_created_and_removed():
    c = Client()
    c.ok(FtpOpcode.MAKE_FOLDER, "/a/deep")
    c.ok(FtpOpcode.MAKE_FOLDER, "/a/deep/er")
    assert c.refused(FtpOpcode.MAKE_FOLDER, "/a/deep") is FtpError.EXISTS
    assert c.refused(FtpOpcode.MAKE_FOLDER, "/no/deep") is FtpError.NOT_FOUND
    assert c.refused(FtpOpcode.REMOVE_FOLDER, "/a/deep") is FtpError.FAIL_ERRNO
    assert c.refused(FtpOpcode.REMOVE_FOLDER, "/") is FtpError.PROTECTED
    c.ok(FtpOpcode.REMOVE_FOLDER, "/a/deep/er")
    c.ok(FtpOpcode.REMOVE_FOLDER, "/a/deep")
    assert c.refused(FtpOpcode.REMOVE_FOLDER, "/a/deep") is FtpError.NOT_FOUND
    assert c.refused(FtpOpcode.REMOVE, "/a") is FtpError.FAIL
    assert c.refused(FtpOpcode.CREATE, "/a") is FtpError.FAIL_ERRNO


@pytest.mark.parametrize("path", ["/a/../b.txt", "/" + "x" * 230, "/a/b\tc"])
def test_invalid_path_is_not_found(path):
    assert Client().refused(FtpOpcode.CREATE, path) is FtpError.NOT_FOUND


def test_ardupilot_and_px4_file_servers_differ_as_recorded():
    texts = []
    ardupilot = Client(FtpServer(FileTree({"/f": b"1"}), ARDUPILOT, texts.append))
    px4 = Client(FtpServer(FileTree({"/f": b"1"}), PX4, texts.append))
    assert ardupilot.refused(16, "/") is FtpError.FAIL
    assert px4.refused(16, "/") is FtpError.UNKNOWN_COMMAND
    assert texts == ["Unsupported FTP: 16"]
    assert ardupilot.refused(FtpOpcode.LIST, "") is FtpError.INVALID_DATA_SIZE
    assert px4.listing("") == px4.listing("/") == ["Ff\t1"]
    assert ardupilot.ok(FtpOpcode.OPEN_READ, "/f", session=77).session == 77
    assert px4.ok(FtpOpcode.OPEN_READ, "/f", session=77).session == 0
    assert ardupilot.refused(FtpOpcode.OPEN_READ, "/f", session=78) is FtpError.FAIL, "one file at a time"
    assert px4.refused(FtpOpcode.OPEN_READ, "/f") is FtpError.NO_SESSIONS
    assert ardupilot.refused(FtpOpcode.READ, session=5, size=1) is FtpError.NOT_FOUND
    assert px4.refused(FtpOpcode.READ, session=5, size=1) is FtpError.INVALID_SESSION
    ardupilot.ok(FtpOpcode.TERMINATE, session=5)
    assert px4.refused(FtpOpcode.TERMINATE, session=5) is FtpError.INVALID_SESSION
    for client, size in ((ardupilot, b""), (px4, b"\x02\0\0\0")):
        client.ok(FtpOpcode.RESET)
        session = client.ok(FtpOpcode.CREATE, "/new").session
        assert client.ok(FtpOpcode.WRITE, session=session, data=b"ab").data == size
        client.ok(FtpOpcode.TERMINATE, session=session)
    assert ardupilot.refused(FtpOpcode.OPEN_WRITE, "/none") is FtpError.NOT_FOUND
    px4.ok(FtpOpcode.OPEN_WRITE, "/none")
    assert ardupilot.refused(FtpOpcode.TRUNCATE, "/f") is FtpError.FAIL
    px4.ok(FtpOpcode.TRUNCATE, "/f")
    assert px4.server.tree.read("/f") == b""


def test_file_is_renamed():
    c = Client()
    c.ok(FtpOpcode.RENAME, b"/b.txt\0/a/c.txt")
    assert c.listing("/a") == ["Fc.txt\t0", "Flog.bin\t25600", "Fone.txt\t1"]
    assert c.refused(FtpOpcode.RENAME, b"/b.txt\0/d.txt") is FtpError.NOT_FOUND
    assert c.refused(FtpOpcode.RENAME, b"/a/c.txt\0/a") is FtpError.FAIL_ERRNO
    assert c.refused(FtpOpcode.RENAME, b"/a/c.txt") is FtpError.FAIL_ERRNO


def test_generated_file_reports_another_size_and_checksum():
    generated = GeneratedFile(lambda: b"12345", lambda: 999, checks=False)
    c = Client(FtpServer(FileTree({}, {"@PARAM/x": generated}, {"@PARAM": ("Fx\t999",)}), ARDUPILOT))
    assert c.listing("@PARAM/") == ["Fx\t999"]
    opened = c.ok(FtpOpcode.OPEN_READ, "@PARAM/x")
    assert struct.unpack("<I", opened.data) == (999,)
    assert c.ok(FtpOpcode.READ, size=80).data == b"12345"
    assert struct.unpack("<I", c.ok(FtpOpcode.CRC32, "@PARAM/x").data) != (ftp_crc32(b"12345"),)


def test_reset_frees_only_the_client_s_own_session():
    c = Client()
    c.ok(FtpOpcode.OPEN_READ, "/b.txt")
    other = Client(c.server, (1, 191))
    assert other.refused(FtpOpcode.OPEN_READ, "/b.txt") is FtpError.NO_SESSIONS
    other.ok(FtpOpcode.RESET)
    assert other.refused(FtpOpcode.OPEN_READ, "/b.txt") is FtpError.NO_SESSIONS
    c.ok(FtpOpcode.RESET)
    other.ok(FtpOpcode.OPEN_READ, "/b.txt")
    assert c.refused(FtpOpcode.READ, size=1) is FtpError.INVALID_SESSION, (
        "another client's session is refused"
    )


def test_repeated_request_is_carried_out_once():
    c = Client()
    request = FtpPacket(8, 0, FtpOpcode.REMOVE, 6, data=b"/b.txt")
    assert c.send(request).opcode == ACK
    assert c.send(request).opcode == ACK, "the first reply may be lost"
    assert c.refused(FtpOpcode.REMOVE, "/b.txt") is FtpError.NOT_FOUND


def test_file_tree_is_bounded():
    tree = FileTree({})
    c = Client(FtpServer(tree))
    for number in range(MAX_ENTRIES - 1):
        c.ok(FtpOpcode.MAKE_FOLDER, f"/{number}")
    assert c.refused(FtpOpcode.MAKE_FOLDER, "/more") is FtpError.FAIL_ERRNO
    c = Client()
    session = c.ok(FtpOpcode.OPEN_WRITE, "/b.txt").session
    assert c.refused(FtpOpcode.WRITE, session=session, offset=MAX_FILE, data=b"1") is FtpError.FAIL_ERRNO
    assert c.refused(FtpOpcode.WRITE, session=session, offset=0xFFFFFFFF, data=b"1") is FtpError.FAIL_ERRNO


def test_oversized_read_is_refused():
    assert Client().refused(FtpOpcode.READ, size=DATA + 1) is FtpError.INVALID_DATA_SIZE


@settings(max_examples=200, deadline=None)
@given(st.lists(st.binary(max_size=300), max_size=10))
def test_arbitrary_payloads_do_not_raise(payloads):
    c = Client()
    for payload in payloads:
        c.server.receive(PEER, payload)
        assert len(c.server.advance()) <= 10 * MAX_SESSIONS
    c.ok(FtpOpcode.NONE)


requests = st.builds(
    FtpPacket,
    st.integers(0, 0xFFFF),
    st.integers(0, 7),
    st.one_of(st.sampled_from(list(FtpOpcode)), st.integers(0, 255)),
    st.integers(0, 255),
    st.integers(0, 255),
    st.integers(0, 1),
    st.one_of(st.integers(0, 300), st.integers(0, 0xFFFFFFFF)),
    st.one_of(
        st.sampled_from([b"/", b"/a", b"/a/log.bin", b"/b.txt", b"/new", b"@PARAM/param.pck"]),
        st.binary(max_size=DATA),
    ),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 40), requests), max_size=30))
def test_arbitrary_requests_do_not_raise_and_use_bounded_memory(scenario):
    server = FtpServer(
        FileTree(
            {"/a/log.bin": LOG, "/b.txt": b""},
            {"@PARAM/param.pck": GeneratedFile(lambda: b"x" * 999, lambda: 9)},
        )
    )
    for system, request in scenario:
        replies = server.receive((system, 1), request.write())
        assert len(replies) <= 1
        server.advance()
    assert len(server._sessions) <= MAX_SESSIONS
    assert len(server._last) <= 16
    assert len(server._bursts) <= MAX_SESSIONS


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=3000), st.data())
def test_file_written_over_a_lossy_link_is_complete(content, data):
    """Every request is repeated until its reply arrives; hypothesis draws the losses."""
    server = FtpServer(FileTree({"/d/.keep": b""}))
    client = Client(server)

    def ask(opcode, payload=b"", *, session=0, offset=0):
        client.number += 2
        request = FtpPacket(client.number, session, opcode, len(payload), 0, 0, offset, payload)
        for _ in range(5):
            arrives, returns = data.draw(st.booleans()), data.draw(st.booleans())
            reply = client.send(request) if arrives else None
            if reply is not None and returns:
                return reply
        return client.send(request)

    session = ask(FtpOpcode.CREATE, b"/d/f").session
    for offset in range(0, len(content), DATA):
        piece = content[offset : offset + DATA]
        assert ask(FtpOpcode.WRITE, piece, session=session, offset=offset).opcode == ACK
    ask(FtpOpcode.TERMINATE, session=session)
    assert server.tree.read("/d/f") == content
