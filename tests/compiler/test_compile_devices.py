"""Device fields and device calls: the compiler writes records from the manifest of the driver."""

from __future__ import annotations

from listing import instructions

from lfield.bytecode.program import (
    DEVICE,
    INT,
    REAL,
    VOID,
    DeviceCallRecord,
    DeviceField,
    FieldRecord,
    Program,
)
from lfield.compiler.program_builder import compile_program
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, Instruction, Parameter

_GRIPPER = DeviceManifest(
    "Gripper",
    "test",
    (
        Instruction("close", (Parameter("force", "real", "N"),), effect="idempotent"),
        Instruction("width", (), "real", "m", effect="query"),
        Instruction("path", (Parameter("points", "real[]"), Parameter("count", "int"))),
    ),
)

_TEXT = """
resource Arm {
    int before;
    Gripper left;
    Gripper right;
    init(string[] arg) {
        left.close(5);
        real w = left.width() + right.width();
        right.close(w);
        left.close(1.5);
        right.path(new real[2], 3);
    }
}
"""


def program() -> Program:
    return compile_program(check_text(_TEXT, devices={"Gripper": _GRIPPER}).or_raise())


def test_device_fields_keep_their_order_and_device_names() -> None:
    (arm,) = [record for record in program().core.classes if record.name == "Arm"]
    assert arm.fields == (
        FieldRecord("before", INT),
        FieldRecord("left", DEVICE),
        FieldRecord("right", DEVICE),
    )
    assert arm.devices == (DeviceField("left", "Gripper"), DeviceField("right", "Gripper"))


def test_each_called_device_instruction_has_one_record() -> None:
    compiled = program()
    arm = compiled.class_index["Arm"]
    (reals,) = [i for i, record in enumerate(compiled.core.types) if record.kind == 8 and record.of == REAL]
    assert compiled.core.device_calls == (
        DeviceCallRecord(arm, "left", "Gripper", "close", (REAL,), VOID, "idempotent"),
        DeviceCallRecord(arm, "left", "Gripper", "width", (), REAL, "query"),
        DeviceCallRecord(arm, "right", "Gripper", "width", (), REAL, "query"),
        DeviceCallRecord(arm, "right", "Gripper", "close", (REAL,), VOID, "idempotent"),
        DeviceCallRecord(arm, "right", "Gripper", "path", (reals, INT), VOID, "actuate"),
    )


def test_device_calls_compile_to_groups() -> None:
    assert instructions(program(), "Arm.init") == [
        "push, 5.0",
        "device, left.close",
        "device, left.width",
        "pop, ^3",
        "device, right.width",
        "pop, ^4",
        "addf, ^2, ^3, ^4",
        "push, ^2",
        "device, right.close",
        "push, 1.5",
        "device, left.close",
        "newarray, ^5, real[], 2",
        "push, ^5",
        "push, 3",
        "device, right.path",
        "rtn",
    ]
