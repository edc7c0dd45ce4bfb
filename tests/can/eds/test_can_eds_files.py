"""EDS files as tools write them: content that is read, content skipped with a warning, and errors."""

from __future__ import annotations

import logging

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.driver import DeviceError
from lfield_can.eds import EdsError, parse_eds
from lfield_can.protocols.canopen_node import read_eds

DEVICE = "[DeviceInfo]\nVendorName=-\nBaudRate_500=1\n\n"
HEAD = "[FileInfo]\nFileName=drive.eds\nDescription=Antrieb für Türen\n\n" + DEVICE
STATUS = "[6041]\nParameterName=Statusword\nObjectType=0x7\nDataType=0x0006\nAccessType=ro\nPDOMapping=1\n\n"
MODE = "[6060]\nParameterName=Modes of operation\nObjectType=0x7\nDataType=0x0002\nAccessType=rw\n\n"
IDENTITY = (
    "[1018]\nParameterName=Identity\nObjectType=0x9\nSubNumber=2\n\n"
    "[1018sub0]\nParameterName=Number of entries\nDataType=0x0005\nAccessType=const\n\n"
    "[1018sub1]\nParameterName=Vendor ID\nDataType=0x0007\nAccessType=rw\nDefaultValue=0x10\n\n"
)
COB = (
    "[1400]\nParameterName=RPDO\nObjectType=9\n\n"
    "[1400sub1]\nParameterName=COB-ID\nDataType=0x0007\nAccessType=rw\nDefaultValue=$NODEID+0x200\n\n"
)
PLAIN = HEAD + STATUS + MODE + IDENTITY + COB
U8, I8, U16, U32 = 5, 2, 6, 7
PLAIN_TYPES = {(0x6041, 0): U16, (0x6060, 0): I8, (0x1018, 0): U8, (0x1018, 1): U32, (0x1400, 1): U32}


def types(text: str | bytes, keys=PLAIN_TYPES):
    """The data types of objects (None for an absent one), and the codes of the warnings."""
    data = text if isinstance(text, bytes) else text.encode()
    dictionary, warnings = parse_eds("drive.eds", data)
    found = {key: dictionary.get_variable(*key) for key in keys}
    return {key: variable and variable.data_type for key, variable in found.items()}, [
        w.code for w in warnings
    ]


@pytest.mark.parametrize(
    "written",
    [
        PLAIN,
        PLAIN.replace("\n", "\r\n"),
        PLAIN.encode("latin-1"),
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("utf-16"),
        PLAIN.lower().replace("0x", "0X"),
        PLAIN.upper().replace("0X", "0x"),
        PLAIN.replace("=", " = "),
        PLAIN.replace("DataType=0x0006", "DataType=6"),
        PLAIN.replace("DataType=0x0006", "DataType=006"),
        PLAIN.replace("DataType=0x0006", "DataType=0x0006 ; sixteen bits"),
        PLAIN.replace("[6041]", "[6041] ; the status"),
        PLAIN.replace("[6041]", "[ 6041 ]"),
        PLAIN.replace("ObjectType=0x7\n", ""),
        PLAIN.replace("ParameterName=Statusword\n", ""),
        PLAIN.replace("AccessType=ro\n", ""),
        PLAIN.replace("$NODEID+0x200", "0x200+$NODEID"),
        PLAIN.replace("$NODEID+0x200", "$nodeid + 512"),
        PLAIN.replace("$NODEID+0x200", ""),
        PLAIN.replace(DEVICE, ""),
        PLAIN + "[Comments]\nLines=many\n",
        PLAIN + "[DummyUsage]\nDummy0001=0x1\n",
        PLAIN + "[DeviceComissioning]\nNodeID=\nBaudrate=\n",
        "; from a tool\n# and another\n" + PLAIN,
        PLAIN.replace("[1018]\nParameterName=Identity\nObjectType=0x9\nSubNumber=2\n\n", ""),
    ],
)
def test_every_notation_of_an_eds_file_is_read(written):
    assert types(written) == (PLAIN_TYPES, [])


def test_compact_array_is_expanded():
    compact = "[1003]\nObjectType=8\nDataType=0x0007\nCompactSubObj=3\n\n[1003Name]\nNrOfEntries=1\n"
    keys = [(0x1003, subindex) for subindex in range(5)]
    found, warnings = types(PLAIN + compact, keys)
    assert found == dict(zip(keys, [U8, U32, U32, U32, None], strict=True))
    assert warnings == []


def test_data_type_defined_in_the_file_is_resolved():
    own = "[A0]\nObjectType=5\n\n[A0sub1]\nParameterName=Type\nDataType=0x5\nDefaultValue=0x0003\n\n"
    ranged = MODE.replace("6060", "2000").replace("0x0002", "0x00A0")
    assert types(PLAIN + own + ranged, [(0x2000, 0)]) == ({(0x2000, 0): 3}, [])


@pytest.mark.parametrize(
    ("more", "code", "line"),
    [
        ("just words\n", "EDS901", 1),
        ("[6041]\nDataType=0x0007\n", "EDS902", 1),
        ("[2000]\nDataType=5\nDataType=6\n", "EDS902", 3),
        ("[2000]\nDataType=sixteen\n", "EDS903", 2),
        ("[2000]\nParameterName=untyped\n", "EDS904", 1),
        ("[2000]\nDataType=0x0040\n", "EDS905", 2),
    ],
)
def test_unusable_entry_is_a_warning_with_its_line(more, code, line):
    _, warnings = parse_eds("drive.eds", (PLAIN + more).encode())
    assert [(w.code, w.severity) for w in warnings] == [(code, "warning")]
    assert warnings[0].span.line == PLAIN.count("\n") + line
    assert types(PLAIN + more)[0] == PLAIN_TYPES


def test_the_first_of_two_definitions_counts():
    assert types(PLAIN + "[6041]\nDataType=0x0007\n")[0][0x6041, 0] == U16
    assert types(PLAIN.replace("DataType=0x0006", "DataType=0x0006\nDATATYPE=7"))[0][0x6041, 0] == U16


@pytest.mark.parametrize(
    "text", ["", "\0\0\0", HEAD, "import os\n", 'VERSION ""\nBO_ 1 A: 8 X\n', "<?xml?>\n"]
)
def test_eds_file_without_objects_is_refused_with_its_place(tmp_path, text):
    with pytest.raises(EdsError) as error:
        parse_eds("drive.eds", text.encode())
    assert [finding.code for finding in error.value.findings] == ["EDS101"]
    path = tmp_path / "drive.eds"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DeviceError, match=r"is not a readable EDS file: .*:1:1: error\[EDS101\]"):
        read_eds("axis", str(path), 5)


def test_missing_eds_file_is_a_device_error(tmp_path):
    with pytest.raises(DeviceError, match="is not a readable EDS file: No such file"):
        read_eds("axis", str(tmp_path / "none.eds"), 5)


def test_eds_warnings_are_noted(tmp_path):
    path, notes = tmp_path / "drive.eds", []
    path.write_text(PLAIN + "[2000]\nParameterName=untyped\n", encoding="utf-8")
    assert read_eds("axis", str(path), 5, notes.append).get_variable(0x6041, 0).name == "Statusword"
    assert len(notes) == 1
    assert notes[0].startswith(f"{path}:{PLAIN.count(chr(10)) + 1}:1: warning[EDS904]: object 0x2000:0")


@given(st.text(alphabet="[]=;0x16041sub\n DataType$", max_size=200), st.integers(0, len(PLAIN)))
def test_any_eds_text_is_read_or_refused(junk, at):
    try:
        dictionary, _ = parse_eds("drive.eds", (PLAIN[:at] + junk + PLAIN[at:]).encode())
    except EdsError as error:
        dictionary = None
        assert error.findings  # noqa: PT017
    assert dictionary is None or len(dictionary)


def test_data_types_equal_those_of_canopen(tmp_path):
    """canopen as reference."""
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    path = tmp_path / "drive.eds"
    path.write_text(PLAIN, encoding="utf-8")
    reference = canopen.import_od(str(path), 5)
    assert {key: reference.get_variable(*key).data_type for key in PLAIN_TYPES} == types(PLAIN)[0]
