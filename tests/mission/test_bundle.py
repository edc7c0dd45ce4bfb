"""A mission in one file: the same bytes for the same files, and a sentence for all other bytes."""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from missions import PLAIN_DEPLOYMENT, write_plain, write_rich
from msgspec.structs import replace

from lfield.capability.condition_compiler import compile_constraint
from lfield.capability.condition_encoding import encode_tree
from lfield.capability.registry_reader.registry_files import digest as digest_of_registry
from lfield.errors import BundleError, InputFileError
from lfield.lang.deployment import read_deployment
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission


@pytest.fixture(scope="module")
def rich(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    return load_mission(write_rich(tmp_path_factory.mktemp("rich")))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    return load_mission(write_plain(tmp_path_factory.mktemp("plain")))


@pytest.fixture(scope="module")
def data(rich: Mission) -> bytes:
    return bundle.encode(rich)


def sealed(data: bytes, **changed: bytes) -> bytes:
    """The bundle with some parts replaced, and all digests recomputed."""
    parts = {name: changed.get(name, bytes(part)) for name, part in bundle.contents(data).parts.items()}
    rows = [bundle.PartEntry(name, len(part), hashlib.sha256(part).digest()) for name, part in parts.items()]
    table = msgspec.msgpack.encode(rows)
    header = bundle._HEADER.pack(b"LFMB", bundle.VERSION, 0, len(table), hashlib.sha256(table).digest())
    return header + table + b"".join(parts.values())


def test_a_signature_is_stored_after_the_parts_and_not_decoded(data: bytes, rich: Mission) -> None:
    """`authority/bundle_signature.py` checks it; a bundle with a signature is the same bundle."""
    once = bundle.with_signature(data, b"signed")
    assert (bundle.contents(data).signature, bundle.contents(once).signature) == (b"", b"signed")
    assert bundle.contents(once)[:3] == bundle.contents(data)[:3]
    assert bundle.decode(once).program.digest == rich.program.digest
    again = bundle.with_signature(once, b"signed by another")
    assert (
        again == data[:6] + len(b"signed by another").to_bytes(2, "little") + data[8:] + b"signed by another"
    )
    assert bundle.with_signature(again, b"") == data
    for cut in (once[:-1], once + b"\0", data[:6] + b"\1\0" + data[8:], data[:6] + b"\xff\xff" + data[8:]):
        with pytest.raises(BundleError):
            bundle.contents(cut)


# --- round trip ----------------------------------------------------------------------------------


def test_a_mission_is_encoded_and_decoded_unchanged(rich: Mission, data: bytes) -> None:
    read = bundle.decode(data)
    assert (read.name, read.warnings) == (rich.name, rich.warnings)
    assert "this statement is unreachable" in read.warnings[0]
    assert (read.program.core, read.program.debug) == (rich.program.core, rich.program.debug)
    assert read.program.digest == rich.program.digest
    assert read.team == rich.team
    assert read.bindings == rich.bindings
    assert read.needed == rich.needed
    assert read.drivers.by_driver == {"dynamixel": rich.drivers.by_driver["dynamixel"].without_local_parts}
    assert read.world == "hardware"
    assert read.on_fakes().world == "fakes"


def test_the_decoded_registry_gives_the_same_answers(rich: Mission, data: bytes) -> None:
    read = bundle.decode(data).registry
    assert rich.registry is not None
    assert read is not None
    assert read.digest == rich.registry.digest
    # The content relevant for answers, written canonically; live attributes are resolved in both.
    assert digest_of_registry(read) == digest_of_registry(rich.registry)
    assert read.providers["Crane"].live["boom"].factor == pytest.approx(57.29578)
    assert list(read.compositions["grip-and-climb"].needs) == list(
        rich.registry.compositions["grip-and-climb"].needs
    )


def test_digests_of_program_and_team_are_their_identities(rich: Mission, data: bytes) -> None:
    table = {row.name: row.digest for row in bundle.contents(data).table}
    assert table["program"] == rich.program.digest
    assert table["team"] == rich.team.deployment


def test_a_team_has_the_hash_of_its_deployment(tmp_path: Path, rich: Mission) -> None:
    assert rich.team.deployment.hex() == read_deployment(write_rich(tmp_path), None).hash


def test_a_mission_without_devices_and_capabilities_is_small(plain: Mission) -> None:
    data = bundle.encode(plain)
    read = bundle.decode(data)
    assert read.registry is None
    assert read.world == ""
    assert read.drivers.by_driver == {}
    assert len(data) < 4000


def test_addresses_are_not_part_of_the_team(rich: Mission) -> None:
    moved = bundle.encode(rich.at(rich.team.at({"yard": "10.0.0.7:1"})))
    before, after = bundle.contents(bundle.encode(rich)).table, bundle.contents(moved).table
    assert [a.name for a, b in zip(before, after, strict=True) if a != b] == ["bindings"]
    assert bundle.decode(moved).team.addresses == ("10.0.0.7:1", "dock:9000")


@pytest.mark.few(0)
def test_the_same_files_give_the_same_bundle_in_any_folder_and_process(tmp_path: Path) -> None:
    made = []
    for number, folder in enumerate((tmp_path / "here", tmp_path / "there" / "deep")):
        write_rich(folder)
        environment = {**os.environ, "PYTHONHASHSEED": str(number)}
        command = [sys.executable, "-m", "lfield", "build", "mission.dL"]
        subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, timeout=60)
        made.append((folder / "mission.lfm").read_bytes())
    assert made[0] == made[1]
    assert str(tmp_path).encode() not in made[0]


def stating(mission: Mission, **values: object) -> bytes:
    agent = mission.team.deployed[0].id
    return bundle.encode(mission.with_bindings(replace(mission.bindings, attributes={agent: values})))


def test_stated_attributes_of_bindings_are_in_the_bundle(rich: Mission) -> None:
    agent = rich.team.deployed[0].id
    read = bundle.decode(stating(rich, payload=1.5, tools=("hook", "winch")))
    assert read.bindings.attributes == {agent: {"payload": 1.5, "tools": ("hook", "winch")}}


@pytest.mark.parametrize("wrong", [{"payload": "heavy"}, {"tools": 3}, {"nonsense": 1.0}, {"payload": True}])
def test_invalid_stated_attributes_are_refused(rich: Mission, wrong: dict[str, object]) -> None:
    assert f"bindings state {next(iter(wrong))} = " in reason(stating(rich, **wrong))


# --- invalid bytes -------------------------------------------------------------------------------


def reason(data: bytes) -> str:
    with pytest.raises(BundleError) as error:
        bundle.decode(data)
    assert error.value.exit_status == 65
    return str(error.value)


def test_other_files_are_refused(data: bytes) -> None:
    assert "does not start with the header of a bundle" in reason(b"")
    assert "does not start with the header of a bundle" in reason(b"LFLP" + data[4:])
    assert "is larger than 64 MiB" in reason(data.ljust(bundle.MAX_SIZE + 1, b"\0"))


def test_a_bundle_of_another_version_is_refused_with_both(data: bytes) -> None:
    newer = data[:4] + (bundle.VERSION + 1).to_bytes(2, "little") + data[6:]
    text = reason(newer)
    assert f"has format {bundle.VERSION + 1}, this lfield reads format {bundle.VERSION}" in text
    assert "install the version of lfield that built it" in text


@given(st.data())
def test_any_changed_byte_is_detected(data: bytes, draw: st.DataObject) -> None:
    at = draw.draw(st.integers(0, len(data) - 1))
    wrong = bytes([data[at] ^ draw.draw(st.integers(1, 255))])
    reason(data[:at] + wrong + data[at + 1 :])


@given(st.data())
def test_truncated_and_extended_bundles_are_refused(data: bytes, draw: st.DataObject) -> None:
    reason(data[: draw.draw(st.integers(0, len(data) - 1))])
    reason(data + draw.draw(st.binary(min_size=1, max_size=9)))


@given(st.sampled_from(bundle.PARTS), st.data())
def test_invalid_parts_with_valid_digests_are_refused(data: bytes, part: str, draw: st.DataObject) -> None:
    """An author of a bundle can also write its digests: the content is checked in any case."""
    old = bytes(bundle.contents(data).parts[part])
    start, end = sorted((draw.draw(st.integers(0, len(old))), draw.draw(st.integers(0, len(old)))))
    new = old[:start] + draw.draw(st.binary(max_size=6)) + old[min(end, start + 6) :]
    with contextlib.suppress(BundleError):
        assert isinstance(bundle.decode(sealed(data, **{part: new})), Mission)


@pytest.mark.parametrize("part", bundle.PARTS)
def test_endless_nesting_is_refused(data: bytes, part: str) -> None:
    for deep in (b"\x91" * 200_000, b"\x81\xa1a" * 200_000):
        reason(sealed(data, **{part: deep}))


def test_an_endlessly_nested_condition_is_refused(data: bytes) -> None:
    registry, known = bytes(bundle.contents(data).parts["registry"]), bundle.decode(data).registry
    assert known is not None
    text = "payload > 1.0 && environment == terrestrial"
    old = msgspec.msgpack.encode([text, encode_tree(compile_constraint(text, known.attributes).tree)])
    assert old in registry
    deep: list[object] = ["name", 0, 1, "ready"]
    for _ in range(150):
        deep = ["unary", 0, 1, "!", deep]
    for tree, told in (
        (deep, "nested more than 100 levels"),
        ([*deep[:4], ["name", 0, 1, "heft"]], "no attribute 'heft'"),
        (["name", 0, 99, "ready"], "outside of its text"),
    ):
        new = msgspec.msgpack.encode([text, tree])
        assert told in reason(sealed(data, registry=registry.replace(old, new)))


@pytest.mark.parametrize("word", ["mode", "park"], ids=["needs_arguments", "is_not_there"])
def test_a_cancel_without_an_instruction_is_refused(data: bytes, word: str) -> None:
    drivers = bytes(bundle.contents(data).parts["drivers"])
    old, new = (msgspec.msgpack.encode({"cancel": name})[1:] for name in ("stop", word))
    assert old in drivers
    text = reason(sealed(data, drivers=drivers.replace(old, new)))
    assert "Dynamixel has no instruction for the cancel of moveTo, moveUntil" in text


def test_a_table_of_other_parts_is_refused(data: bytes) -> None:
    rows = [row for row in bundle.contents(data).table if row.name != "registry"]
    table = msgspec.msgpack.encode(rows)
    header = bundle._HEADER.pack(b"LFMB", bundle.VERSION, 0, len(table), hashlib.sha256(table).digest())
    assert "its parts are not those of a bundle" in reason(header + table)


def part_of(mission: Mission, name: str) -> bytes:
    return bytes(bundle.contents(bundle.encode(mission)).parts[name])


def test_parts_of_different_missions_are_refused(rich: Mission, plain: Mission, data: bytes) -> None:
    assert "which the program does not define" in reason(sealed(data, team=part_of(plain, "team")))
    assert "is not bound" in reason(sealed(data, bindings=part_of(plain, "bindings")))
    assert "which is not in the bundle" in reason(sealed(data, drivers=part_of(plain, "drivers")))
    assert "its program is invalid" in reason(sealed(data, texts=part_of(plain, "texts")))


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ([], "has 0 agents"),
        ([("Echo", "a", "x", ()), ("Echo", "a", "y", ())], "two agents of the team have the same name"),
        ([("Exception", "a", "x", ())], "agent 'a' has the type 'Exception'"),
        ([("Echo", "", "x", ())], "a name in the team is too long, or empty"),
        ([("Echo", "a", "x" * 200, ())], "a name in the team is too long, or empty"),
        ([("Echo", "a", "x")], "its team cannot be decoded"),
        ([("", "", "x", ())], "has 0 agents and 1 witnesses"),
        ([("", "", "y", ()), ("Echo", "a", "x", ())], "a witness of the team has agents, or is listed twice"),
        ([("Echo", "a", "x", ()), ("", "", "x", ())], "a witness of the team has agents, or is listed twice"),
        (
            [("Echo", "a", "x", ()), ("", "", "y", ()), ("", "", "y", ())],
            "a witness of the team has agents, or is listed twice",
        ),
        (
            [("Echo", "a", "x", ()), ("", "w", "y", ())],
            "a witness of the team has agents, or is listed twice",
        ),
        (
            [("Echo", "a", "x", ()), ("", "", "y", ("1",))],
            "a witness of the team has agents, or is listed twice",
        ),
        ([("Echo", "a", "x", ()), ("", "", "", ())], "a name in the team is too long, or empty"),
    ],
)
def test_an_invalid_team_is_refused(plain: Mission, rows: list[object], told: str) -> None:
    assert told in reason(sealed(bundle.encode(plain), team=msgspec.msgpack.encode(rows)))


def test_an_invalid_file_is_named_with_the_reason(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "mission.lfm"
    path.write_bytes(data[:-1])
    with pytest.raises(BundleError, match=r"mission.lfm is not a valid bundle: it is truncated"):
        bundle.read(path)
    with pytest.raises(InputFileError, match="no such file"):
        bundle.read(tmp_path / "nobody.lfm")


def test_the_plain_deployment_has_its_agents(plain: Mission) -> None:
    assert [f"//{a.type}:{a.id}@{a.host}" for a in plain.team.deployed] == [
        line.partition("?")[0] for line in PLAIN_DEPLOYMENT.splitlines()
    ]
