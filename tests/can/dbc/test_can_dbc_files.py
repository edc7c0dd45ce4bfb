"""DBC files as tools write them: content that is read, content skipped with a warning, and errors."""

from __future__ import annotations

import random

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield_can.bus.frames import Frame
from lfield_can.dbc import DbcError, DbcFile, representable

HEAD = 'VERSION ""\n\nNS_ :\n\tCM_\n\tVAL_\n\tSG_MUL_VAL_\n\nBS_:\n\nBU_: Host Arm\n\n'
ARM = HEAD + (
    "BO_ 291 Arm: 8 Arm\n"
    ' SG_ speed : 0|16@1- (0.1,0) [0|0] "rad/s" Host\n'
    ' SG_ angle : 23|16@0- (0.01,0) [-180|180] "°" Host\n'
    ' SG_ heat : 32|8@1+ (1,-40) [0|0] "°C" Host\n'
)


@pytest.fixture
def read(tmp_path):
    def make(text: str | bytes) -> DbcFile:
        path = tmp_path / "arm.dbc"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return DbcFile(str(path))

    return make


def codes(file: DbcFile) -> list[tuple[str, int]]:
    return [(finding.code, finding.span.line) for finding in file.warnings]


# -- skipped content ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ('VAL_ 291 nothing 0 "off" 1 "on";\n', "DBC910"),
        ('VAL_ 999 speed 0 "off";\n', "DBC910"),
        ("SIG_VALTYPE_ 291 nothing : 1;\n", "DBC910"),
        ("SG_MUL_VAL_ 291 nothing page 1-2;\n", "DBC910"),
        ("BO_ 3221225473 Ghost: 8 Arm\n", "DBC902"),
        ("BO_ 1075054137 Ghost: 8 Arm\n", "DBC902"),
        ("BO_ 292 Long: 65 Arm\n", "DBC903"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ none : 0|0@1+ (1,0) [0|0] "" Host\n', "DBC904"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ wide : 0|65@1+ (1,0) [0|0] "" Host\n', "DBC904"),
        ("BO_ 291 Again: 8 Arm\n", "DBC905"),
        ("BO_ 292 Arm: 8 Arm\n", "DBC905"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ part m1 : 0|8@1+ (1,0) [0|0] "" Host\n', "DBC906"),
        ("BO_ 292 : 8 Arm\n", "DBC907"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ : 0|8@1+ (1,0) [0|0] "" Host\n', "DBC907"),
        ("B0_TX_BU_ 291 : Arm;\n", "DBC908"),
        ("BO_ 2048 Arm2: 8 Arm\n", "DBC909"),
        ('CM_ BO_ 291 "no end"\nBO_ 292 Arm2: 8 Arm\n', "DBC911"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ turned : 0|8@1+ (1,0) [9|1] "" Host\n', "DBC912"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ flat : 0|8@1+ (0,0) [0|0] "" Host\n', "DBC913"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ page m : 0|8@1+ (1,0) [0|0] "" Host\n', "DBC915"),
        ('BO_ 292 Arm2: 8 Arm\n SG_ far : 0|8@1+ (1,0) [500|900] "" Host\n', "DBC916"),
    ],
)
def test_unusable_line_is_a_warning_with_its_line_and_the_rest_is_read(read, more, code):
    file = read(ARM + more)
    (warning,) = file.warnings
    assert (warning.code, warning.severity) == (code, "warning")
    assert warning.span.line >= ARM.count("\n") + 1
    assert warning.hint
    assert file.decode(Frame(291, bytes([10, 0, 0, 0, 65, 0, 0, 0])))[1]["heat"] == 25.0


def test_signals_without_a_message_give_no_warning(read):
    independent = (
        'BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n SG_ spare : 0|8@1+ (1,0) [0|0] "" X\n'
    )
    assert read(ARM + independent).warnings == ()


def test_dbc_file_without_messages_is_read_and_other_content_is_refused(read):
    assert codes(read(HEAD)) == [("DBC914", 1)]
    for text in ("", "\0\0", "import asyncio\n", "[DeviceInfo]\nBaudRate_500=1\n"):
        with pytest.raises(DbcError, match="cannot be read") as error:
            read(text)
        assert [finding.code for finding in error.value.findings] == ["DBC101"]


def test_signal_beyond_its_frame_is_named_and_the_others_are_used(read):
    file = read(
        HEAD + 'BO_ 5 Arm: 2 X\n SG_ near : 0|8@1+ (1,0) [0|0] "" X\n SG_ far : 12|8@1+ (1,0) [0|0] "" X\n'
    )
    assert codes(file) == [("DBC901", 14)]
    assert "far" in file.warnings[0].message
    assert file.decode(Frame(5, bytes([7, 8]))) == ("Arm", {"near": 7.0})
    assert file.encode("Arm", {"near": 9.0}).data == bytes([9, 0])
    for call in (lambda: file.encode("Arm", {"near": 9.0, "far": 1.0}), lambda: file.signal("Arm", "far")):
        with pytest.raises(DbcError, match=r"Arm\.far cannot be used: .*beyond its frame"):
            call()


# -- errors ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "code", "column"),
    [
        ("BO_ 0x123 Arm: 8 X", "DBC102", 5),
        ("BO_ 292 Arm 8 X", "DBC102", 5),
        ('BO_ 292 A: 8 X\n SG_ a 0|8@1+ (1,0) [0|0] "" X', "DBC102", 6),
        ('BO_ 292 A: 8 X\n SG_ a : 0|8@2+ (1,0) [0|0] "" X', "DBC102", 13),
        ('BO_ 292 A: 8 X\n SG_ a : 0|8@1+ (1,5,0) [0|0] "" X', "DBC102", 17),
        ("BO_ 292 A: 8 X\n SG_ a : 0|8@1+ (1,0) [0|] X", "DBC102", 28),
        ('CM_ "x";\n SG_ a : 0|8@1+ (1,0) [0|0] "" X', "DBC103", 6),
        ('CM_ "never closed;', "DBC104", 5),
    ],
)
def test_syntax_error_has_line_and_column(read, line, code, column):
    with pytest.raises(DbcError) as error:
        read(ARM + line + "\n")
    (finding,) = error.value.findings
    assert (finding.code, finding.span.column) == (code, column)
    assert finding.span.line == ARM.count("\n") + 1 + line.count("\n")
    place = f"arm.dbc:{finding.span.line}:{finding.span.column}: error[{code}]"
    assert place in str(error.value)
    assert finding.hint in str(error.value)


def test_all_syntax_errors_are_reported_in_one_run(read):
    with pytest.raises(DbcError, match=r"and 2 more mistakes") as error:
        read(ARM + "BO_ x\n" * 5)
    assert len(error.value.findings) == 5


@given(st.text(alphabet='BO_SG: 0123|@+-()[]",;mMVALCN\n\t x.e\\', max_size=300), st.integers(0, len(ARM)))
def test_any_text_is_read_or_refused_with_its_line(tmp_path_factory, junk, at):
    path = tmp_path_factory.getbasetemp() / "junk.dbc"
    path.write_text(ARM[:at] + junk + ARM[at:], encoding="utf-8")
    try:
        file = DbcFile(str(path))
    except DbcError as error:
        refused = error.findings
    else:
        refused = None
    assert refused is None or refused[0].span.line >= 1
    for name in [] if refused else file.names:
        file.decode(Frame(file.message(name).frame_id, bytes(8), file.message(name).is_extended_frame))


# -- notations ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "encoded",
    [
        ARM.encode(),
        ARM.encode("utf-8-sig"),
        ARM.encode("latin-1"),
        ARM.encode("cp1252"),
        ARM.encode("utf-16"),
        b"\xff\xfe" + ARM.encode("utf-16-le"),
        b"\xfe\xff" + ARM.encode("utf-16-be"),
        ARM.encode("utf-16-le"),
        ARM.replace("\n", "\r\n").encode("latin-1"),
        ARM.replace("\n", "\r").encode(),
    ],
)
def test_encodings_byte_order_marks_and_line_ends(read, encoded):
    file = read(encoded)
    assert [file.signal("Arm", name).unit for name in ("speed", "angle", "heat")] == ["rad/s", "°", "°C"]
    assert file.warnings == ()


def test_shift_jis_comments_do_not_hide_later_lines(read):
    # The second byte of a character may be a backslash, also before the closing quote.
    text = ARM.replace("°", "") + 'CM_ SG_ 291 speed "モーター速度の表示、能力表";\nBO_ 292 Leg: 8 X\n'
    file = read(text.encode("shift_jis"))
    assert file.names == ["Arm", "Leg"]
    assert file.warnings == ()


@pytest.mark.parametrize(
    "more",
    [
        'CM_ BO_ 291 "a comment; with\nBO_ 292 Arm: 8 X\nin it";\n',
        'CM_ "a path C:\\";\n',
        'CM_ "a quote \\" in it";\n',
        'CM_ SG_ 291 "no signal named";\n',
        "// not of the format, and often there\n",
        'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_ "GenMsgCycleTime" BO_ 291 100;\n',
        "BO_TX_BU_ 291 : Host,Arm;\n",
        'VAL_TABLE_ onOff 1 "on" 0 "off";\n',
        "SIG_GROUP_ 291 both 1 : speed angle;\n",
    ],
)
def test_lines_without_signal_data_are_skipped(read, more):
    file = read(ARM + more + 'BO_ 292 Leg: 8 X\n SG_ x : 0|8@1+ (1,0) [0|0] "" X\n')
    assert file.names == ["Arm", "Leg"]
    assert file.warnings == ()


def test_node_names_on_separate_lines_are_read(read):
    assert read(ARM.replace("BU_: Host Arm", "BU_:\n\tHost\n\tArm")).warnings == ()


def test_unusual_names_and_numbers_are_read(read):
    file = read(
        HEAD + 'BO_ 1275 2017_5: 8 X\n SG_ 0_COUNTER : 35|4@0+ (.25,-500) [-500|-496.25] "" X\n'
        ' SG_ a-b : 8 | 8 @ 1 + ( 1e0 , +0. ) [ 0 | 255 ] "" X\n'
    )
    assert file.encode("2017_5", {"0_COUNTER": -496.25, "a-b": 255.0}).data == bytes(
        [0, 255, 0, 0, 15, 0, 0, 0]
    )


def test_long_names_are_read_from_attributes(read):
    file = read(
        ARM + 'BA_ "SystemMessageLongSymbol" BO_ 291 "Arm_of_the_robot_with_a_name_of_more_than_32";\n'
        'BA_ "SystemSignalLongSymbol" SG_ 291 speed "speed of the joint: shoulder, yaw";\n'
        'VAL_ 291 speed 0 "stands";\n'
    )
    assert file.terms(["Arm_of_the_robot_with_a_name_of_more_than_32.speed of the joint: shoulder, yaw=1.5"])
    assert file.warnings == ()


@pytest.mark.parametrize(
    ("id", "frame"),
    [
        (0x7FF, Frame(0x7FF)),
        (0x800 | 1 << 31, Frame(0x800, extended=True)),
        (0x123 | 1 << 31, Frame(0x123, extended=True)),
        (0x18FEF100 | 1 << 31, Frame(0x18FEF100, extended=True)),
        (0x18FEF100, Frame(0x18FEF100, extended=True)),
    ],
)
def test_message_id_selects_standard_or_extended_frame(read, id, frame):
    file = read(f'{HEAD}BO_ {id} Arm: 8 X\n SG_ x : 0|8@1+ (1,0) [0|0] "" X\n')
    assert file.decode(frame._replace(data=bytes([7]))) == ("Arm", {"x": 7.0})
    assert file.decode(frame._replace(data=bytes([7]), extended=not frame.extended)) is None


@pytest.mark.parametrize("none", ["-1.#INF|1.#INF", "-inf|INF", "nan|nan", "1.#QNAN|-1.#IND00", "|"])
def test_non_finite_range_ends_are_no_limits(read, none):
    file = read(f'{HEAD}BO_ 9 Arm: 1 X\n SG_ x : 0|8@1+ (1,0) [{none}] "" X\n')
    assert (file.signal("Arm", "x").minimum, file.signal("Arm", "x").maximum) == (None, None)
    assert file.warnings == ()


# -- bits --------------------------------------------------------------------------------------------------


def test_range_ends_are_valid_despite_rounding(read):
    file = read(
        HEAD + "BO_ 5 Car: 8 X\n"
        ' SG_ accel : 0|11@1+ (0.01,-10.23) [-10.23|10.24] "" X\n'
        ' SG_ stamp : 16|32@1+ (0.1,0) [0|4.29497e+08] "ms" X\n'
        ' SG_ angle : 48|10@1+ (0.03125,-10) [-10|21.9687] "deg" X\n'
    )
    ends = {"accel": (-10.23, 10.24), "stamp": (0.0, 429496729.5), "angle": (-10.0, 21.96875)}
    for at in (0, 1):
        values = {name: end[at] for name, end in ends.items()}
        frame = file.encode("Car", values)
        assert file.decode(frame)[1] == pytest.approx(values)
    for name, value in (
        ("accel", 10.25),
        ("accel", -10.24),
        ("stamp", 429496730.0),
        ("stamp", -0.1),
        ("angle", 21.98),
    ):
        with pytest.raises(DbcError, match=f"{name} cannot be"):
            file.encode("Car", {**dict.fromkeys(ends, 0.0), name: value})


@given(
    st.integers(1, 64), st.booleans(), st.booleans(), st.sampled_from([1.0, 0.1, -0.005, 1e-9, 0.0625, 3e5]),
    st.sampled_from([0.0, -40.0, 0.07, 1e6]),
)  # fmt: skip
def test_minimum_and_maximum_of_any_signal_can_be_sent(
    tmp_path_factory, bits, motorola, signed, scale, offset
):
    path = tmp_path_factory.getbasetemp() / "ends.dbc"
    start, order, sign = (7, 0, "+") if motorola else (0, 1, "-" if signed else "+")
    path.write_text(f'BO_ 5 M: 8 X\n SG_ x : {start}|{bits}@{order}{sign} ({scale},{offset}) [0|0] "" X\n')
    file = DbcFile(str(path))
    for end in representable(file.signal("M", "x")):
        sent = file.encode("M", {"x": end})
        assert file.decode(sent)[1]["x"] == pytest.approx(end, rel=1e-9, abs=abs(scale) / 2)


def test_float_signals_of_all_sizes(read):
    file = read(
        HEAD + "BO_ 5 F: 16 X\n"
        ' SG_ half : 0|16@1- (1,0) [0|0] "" X\n SG_ single : 16|32@1- (1,0) [0|0] "" X\n'
        ' SG_ double : 71|64@0- (1,0) [0|0] "" X\nSIG_VALTYPE_ 5 half : 1;\nSIG_VALTYPE_ 5 single : 1;\n'
        "SIG_VALTYPE_ 5 double:2;\n"
    )
    values = {"half": 65504.0, "single": 3.4028234663852886e38, "double": -1.7e308}
    assert file.decode(file.encode("F", values)) == ("F", values)
    assert file.decode(Frame(5, bytes.fromhex("007e") + bytes(14), fd=True))[1].keys() == {"single", "double"}


def test_message_over_8_bytes_is_a_padded_can_fd_frame(read):
    file = read(HEAD + 'BO_ 5 F: 10 X\n SG_ x : 72|8@1+ (1,0) [0|0] "" X\n')
    frame = file.encode("F", {"x": 3.0})
    assert frame.fd
    assert frame.data == bytes([*[0] * 9, 3, 0, 0])


def test_overlapping_signals_are_both_decoded(read):
    file = read(
        HEAD + 'BO_ 5 M: 8 X\n SG_ all : 0|16@1+ (1,0) [0|0] "" X\n SG_ low : 0|8@1+ (1,0) [0|0] "" X\n'
    )
    assert file.decode(Frame(5, bytes([0x34, 0x12, 0, 0, 0, 0, 0, 0])))[1] == {"all": 0x1234, "low": 0x34}


EXTENDED_PAGES = HEAD + (
    'BO_ 5 M: 8 X\n SG_ S0 M : 0|4@1+ (1,0) [0|0] "" X\n SG_ S1 m1M : 4|4@1+ (1,0) [0|0] "" X\n'
    ' SG_ S2 m2 : 8|8@1+ (1,0) [0|0] "" X\n SG_ S3 m0 : 16|8@1+ (1,0) [0|0] "" X\n'
    ' SG_ S4 : 24|8@1+ (1,0) [0|0] "" X\n'
    "SG_MUL_VAL_ 5 S1 S0 1-1, 5-7;\nSG_MUL_VAL_ 5 S2 S0 2-2;\nSG_MUL_VAL_ 5 S3 S1 0-2;\n"
)


@pytest.mark.parametrize(
    ("first", "there"),
    [(0x00, "S0 S4"), (0x21, "S0 S1 S3 S4"), (0x31, "S0 S1 S4"), (0x06, "S0 S1 S3 S4"), (0x02, "S0 S2 S4")],
)
def test_extended_multiplexing_selects_the_signals(read, first, there):
    file = read(EXTENDED_PAGES)
    frame = Frame(5, bytes([first, 1, 2, 3, 0, 0, 0, 0]))
    assert " ".join(sorted(file.decode(frame)[1])) == there
    assert bool(file.problem(frame)) == (first in (0x00, 0x31))
    assert file.selectors("M", "S3") == {"S1": 0.0, "S0": 1.0}


def test_one_signal_name_in_two_pages(read):
    file = read(
        HEAD + 'BO_ 5 M: 8 X\n SG_ page M : 0|8@1+ (1,0) [0|0] "" X\n SG_ x m0 : 8|8@1+ (1,0) [0|0] "" X\n'
        ' SG_ x m1 : 16|8@1+ (1,0) [0|0] "" X\n'
    )
    assert [file.decode(Frame(5, bytes([page, 7, 8])))[1]["x"] for page in (0, 1)] == [7.0, 8.0]


# -- short frames ------------------------------------------------------------------------------------------


def test_short_frame_yields_the_signals_that_fit(read):
    file = read(ARM)
    frame = Frame(291, bytes([10, 0, 0]))
    assert file.decode(frame) == ("Arm", {"speed": 1.0})
    assert file.problem(frame) == "frame 0x123 has 3 bytes, the file specifies 8: signals angle, heat absent"
    assert file.problem(Frame(291, bytes(6))) == "frame 0x123 has 6 bytes, the file specifies 8"
    assert file.problem(Frame(291, bytes(8))) == file.problem(Frame(291, bytes(12), fd=True)) == ""
    assert file.decode(Frame(291)) == ("Arm", {})


def test_decoding_equals_cantools(tmp_path):
    """cantools as reference: the same places, signs, byte orders, scales and pages."""
    path, rng = tmp_path / "both.dbc", random.Random(4)
    path.write_text(EXTENDED_PAGES + ARM[len(HEAD) :], encoding="cp1252")
    own, reference = DbcFile(str(path)), cantools.database.load_file(path)
    for message in reference.messages:
        for _ in range(200):
            data = rng.randbytes(message.length)
            try:
                values = message.decode(data, decode_choices=False)
            except cantools.database.DecodeError:
                assert own.problem(Frame(message.frame_id, data))
                continue
            assert own.decode(Frame(message.frame_id, data))[1] == pytest.approx(values)
