"""Files of earlier releases are read; files of later ones are refused with both versions (formats.md)."""

from __future__ import annotations

import asyncio
import io
from pathlib import Path

import msgspec
import pytest
from memory_network import MemoryNetwork

from lfield.authority.identity import NO_RIGHTS, Identity
from lfield.bytecode import encoding
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.driver.plugins import discover
from lfield.errors import BlockError, HandshakeError, ProgramFileError
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.mission_completion import wait_until_done
from lfield.mission.bindings_file import read_bindings
from lfield.mission.loader import load_mission
from lfield.net.handshake import Handshake
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield.vm.agent import TeamMember
from lfield.vm.inspection import dump_file
from lfield.vm.inspection.block_view import view
from lfield.wire.codec import decode as decode_message
from lfield.wire.fields import MAX_TEXT
from lfield.wire.framing import FrameDecoder
from lfield.wire.messages import PROTOCOL, Hello, IncompatibleHello

FORMATS = Path(__file__).parents[1] / "formats"
PROGRAMS = sorted(FORMATS.glob("program-*.lb"))
DUMPS = sorted(FORMATS.glob("dump-*.block"))
GREETINGS = sorted(FORMATS.glob("greeting-*.bin"))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_a_program_file_of_an_earlier_release_runs(path: Path) -> None:
    mission = load_mission(FORMATS / "hello.dL", path)
    out, log = io.StringIO(), io.StringIO()

    async def scenario() -> str:
        loop = asyncio.get_running_loop()
        network = MemoryNetwork(LoopClock(), on_pending=lambda: loop.call_soon(network.step))
        hosts = [
            Host(
                mission,
                name,
                network.transport(name),
                Logbook(out, log),
                HostOptions(address, clock=LoopClock()),
            )
            for name, address in mission.team.addresses_by_host.items()
        ]
        try:
            await asyncio.gather(*(host.start() for host in hosts))
            (outcome,) = await wait_until_done(hosts[1], 30.0)
        finally:
            for host in hosts:
                await host.stop()
        return outcome.outcome

    assert run_jumping(scenario()) == "died"
    assert "boss: lifting 3.0" in log.getvalue()
    assert "LimitException: too heavy: 3.0\n    at Arm.lift (hello.L:12) in left" in log.getvalue()


def test_a_later_program_file_is_refused_with_both_versions() -> None:
    data = PROGRAMS[-1].read_bytes()
    newer = data[:4] + (encoding.VERSION + 1).to_bytes(2, "little") + data[6:]
    with pytest.raises(
        ProgramFileError, match=f"has format {encoding.VERSION + 1}; this lfield reads formats"
    ):
        encoding.decode(newer)


@pytest.mark.parametrize("path", DUMPS, ids=lambda path: path.name)
def test_a_dump_of_an_earlier_release_is_explained(path: Path) -> None:
    record, program, block = dump_file.decode(path.read_bytes())
    assert (record.host, record.members) == ("alpha", ("left", "boss"))
    assert program.units["Loader"] == "coordinator"
    assert block.trail() == [1, 0]
    # The proxies of that release have no field for a start.
    frame_locals = view(block, program, record.members).threads[0].frames[0].locals
    assert dict(frame_locals)["arm"] == "proxy of left"


def test_a_later_dump_is_refused_with_both_versions() -> None:
    data = DUMPS[-1].read_bytes()
    newer = data[:4] + (dump_file.VERSION + 1).to_bytes(2, "little") + data[6:]
    with pytest.raises(
        BlockError, match=f"has format {dump_file.VERSION + 1}, this lfield reads format {dump_file.VERSION}"
    ):
        dump_file.decode(newer)
    with pytest.raises(BlockError, match="does not start with the header of a dump file"):
        dump_file.decode(data[1:])


def test_a_dump_with_any_flipped_bit_is_refused() -> None:
    record, program, block = dump_file.decode(DUMPS[-1].read_bytes())
    members = enumerate(zip(record.members, record.types, strict=True))
    team = [TeamMember(number, name, type_, "resource", 0) for number, (name, type_) in members]
    data = dump_file.encode(record.host, record.reason, record.limit, team, record.hosts, program, block)
    # The program of an older release is written as a file of this one.
    assert msgspec.structs.replace(dump_file.decode(data)[0], program=record.program) == record
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(BlockError):
            dump_file.decode(bytes(damaged))
    for size in range(len(data)):
        with pytest.raises(BlockError):
            dump_file.decode(data[:size])


ALPHA = Identity("host", "alpha", NO_RIGHTS)


@pytest.mark.parametrize("path", GREETINGS, ids=lambda path: path.name)
def test_a_host_of_another_release_is_refused_with_both_versions(path: Path) -> None:
    ((kind, payload),) = FrameDecoder(dict.fromkeys(range(256), 1 << 16)).feed(path.read_bytes())
    message = decode_message(kind, payload)
    assert isinstance(message, IncompatibleHello)
    with pytest.raises(
        HandshakeError, match=f"bravo uses protocol {PROTOCOL} and its peer protocol 3"
    ) as error:
        Handshake(Hello("host", "bravo", 1), ALPHA, hosts=("alpha", "bravo")).receive(message)
    assert len(str(error.value)) < MAX_TEXT


def test_mission_files_of_0_3_are_valid() -> None:
    folder = FORMATS / "mission-0.3"
    mission = load_mission(folder / "mission.dL", simulate=True)
    assert mission.registry is not None
    assert mission.world == "fakes"
    assert read_registry(mission=folder / "mission.capabilities.yaml").providers


def test_a_devices_file_of_0_3_is_valid() -> None:
    needed = {"carrier": {"fc": "Mavlink"}, "hoist": {"axis": "CanAxis"}, "hand": {"motor": "Dynamixel"}}
    bindings = read_bindings(FORMATS / "devices-0.3.yaml", needed, discover())
    assert bindings.devices["hoist"]["axis"].option("counts") == 10000
