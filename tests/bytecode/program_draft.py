"""A valid program, written by hand, in parts that a test can make invalid one at a time.

Arm is a resource with a device. Guide is a coordinator that calls the portal of Arm. Box is the class of the
argument of that portal. Tool is a resource specific class.

Labels and the positions in handlers count from the start of their method.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import (
    ANY,
    ARRAY,
    BOOLEAN,
    INT,
    OBJECT,
    PROXY,
    REAL,
    STRING,
    VOID,
    ClassRecord,
    Core,
    Debug,
    DeviceCallRecord,
    DeviceField,
    FieldRecord,
    Handler,
    MethodDebug,
    MethodRecord,
    Program,
    Quad,
    SourceText,
    TypeRecord,
    encode_quads,
)
from lfield.bytecode.verifier import verify
from lfield.bytecode.verifier.record_checks import BUILTIN_RECORDS, FIXED_TYPES
from lfield.errors import ProgramFileError

# Indices of the classes after the built-in ones.
BOX, ARM, GUIDE, TOOL = range(len(BUILTIN_RECORDS), len(BUILTIN_RECORDS) + 4)
# Indices of the types after the fixed ones.
T_BOX, T_ARM, T_PROXY, T_GUIDE, T_STRINGS, T_PROXIES, T_INTS, T_TOOL, T_OVERFLOW = range(
    len(FIXED_TYPES), len(FIXED_TYPES) + 9
)
# Methods.
BOX_NEW, BOX_SUM, ARM_INIT, ARM_LIFT, GUIDE_INIT, TOOL_NEW, TOOL_SHOW = range(7)
# Operands that name constants.
ONE, HALF, TRUE, NOTHING, WORD = -1, -2, -3, -4, -5
# Indices of two classes that handlers catch.
EXCEPTION, ARITHMETIC = 0, 6


def _methods() -> list[MethodRecord]:
    def method(name, owner, kind, slots, parameters, result=VOID, handlers=()):  # type: ignore[no-untyped-def]  # a table
        return MethodRecord(name, owner, kind, parameters, result, slots, 0, 0, False, handlers)

    return [
        method("Box", BOX, "constructor", (T_BOX, INT), 1),
        method("sum", BOX, "method", (T_BOX, INT, INT, BOOLEAN, T_INTS, T_BOX, ANY), 1, INT),
        method("init", ARM, "init", (T_ARM, T_STRINGS, STRING, T_TOOL), 1),
        method(
            "lift", ARM, "portal", (T_ARM, T_BOX, REAL, INT, ANY), 2, INT, (Handler(1, 4, 4, EXCEPTION, 4),)
        ),
        method("init", GUIDE, "init", (T_GUIDE, T_STRINGS, T_PROXY, T_PROXIES, T_BOX, INT, STRING), 1),
        method("Tool", TOOL, "constructor", (T_TOOL,), 0),
        method(
            "show", TOOL, "method", (T_TOOL, STRING, T_OVERFLOW), 1, VOID, (Handler(1, 3, 4, ARITHMETIC, 2),)
        ),
    ]


#: The code, method by method.
_CODE: list[list[tuple[str, int, int, int]]] = [
    [("frame", BOX_NEW, 0, 0), ("putf", 0, 0, 1), ("rtn", 0, 0, 0)],
    [
        ("frame", BOX_SUM, 0, 0),
        ("newarray", 4, T_INTS, ONE),  # 1
        ("move", 2, ONE, 0),
        ("pute", 4, 2, 1),
        ("jmp", 8, 0, 0),
        ("gete", 2, 4, ONE),  # 5
        ("getf", 5, 0, 1),
        ("getf", 6, 0, 1),
        ("slti", 3, 2, 1),
        ("bnz", 5, 3, 0),  # 9
        ("eqnull", 3, 5, 0),
        ("bz", 14, 3, 0),
        ("return", 2, 0, 0),
        ("throw", 6, 0, 0),
        ("noreturn", 0, 0, 0),  # 14
    ],
    [
        ("frame", ARM_INIT, 0, 0),
        ("lds", 2, 4, 0),
        ("putf", 0, 0, 2),
        ("push", 2, 0, 0),  # 3
        ("write_str", 0, 0, 0),
        ("new", 3, TOOL, 0),
        ("push", 3, 0, 0),  # 6
        ("call", TOOL_NEW, 0, 0),
        ("push", 3, 0, 0),  # 8
        ("push", NOTHING, 0, 0),
        ("call", TOOL_SHOW, 0, 0),
        ("yield", 0, 0, 0),  # 11
        ("jmp", 11, 0, 0),
    ],
    [
        ("frame", ARM_LIFT, 0, 0),
        ("push", 2, 0, 0),  # 1
        ("device", 0, 0, 0),
        ("pop", 3, 0, 0),
        ("return", 3, 0, 0),  # 4
    ],
    [
        ("frame", GUIDE_INIT, 0, 0),
        ("lds", 6, 4, 0),
        ("push", 6, 0, 0),  # 2
        ("find", ARM, 0, 0),
        ("pop", 2, 0, 0),
        ("findall", ARM, 0, 0),  # 5
        ("pop", 3, 0, 0),
        ("new", 4, BOX, 0),
        ("push", 4, 0, 0),  # 8
        ("push", ONE, 0, 0),
        ("call", BOX_NEW, 0, 0),
        ("push", 2, 0, 0),  # 11
        ("push", 4, 0, 0),
        ("push", HALF, 0, 0),
        ("pcall", ARM_LIFT, 0, 0),  # 14
        ("pop", 5, 0, 0),
        ("hops", 0, 0, 0),  # 16
        ("pop", 5, 0, 0),
        ("putf", 0, 0, 2),
        ("rtn", 0, 0, 0),
    ],
    [("frame", TOOL_NEW, 0, 0), ("rtn", 0, 0, 0)],
    [
        ("frame", TOOL_SHOW, 0, 0),
        ("push", 1, 0, 0),  # 1
        ("write_str", 0, 0, 0),
        ("rtn", 0, 0, 0),
        ("rtn", 0, 0, 0),  # 4
    ],
]


class Draft:
    """The parts of the program; a test changes some and builds the program."""

    def __init__(self) -> None:
        objects = (
            TypeRecord(OBJECT, BOX),
            TypeRecord(OBJECT, ARM),
            TypeRecord(PROXY, ARM),
            TypeRecord(OBJECT, GUIDE),
        )
        arrays = (TypeRecord(ARRAY, STRING), TypeRecord(ARRAY, T_PROXY), TypeRecord(ARRAY, INT))
        others = (TypeRecord(OBJECT, TOOL), TypeRecord(OBJECT, ARITHMETIC))
        self.types = [*FIXED_TYPES, *objects, *arrays, *others]
        self.constants: list[bool | int | float | str | None] = [1, 0.5, True, None, "word"]
        gripper = (DeviceField("hand", "Gripper"),)
        self.classes = [
            *BUILTIN_RECORDS,
            ClassRecord("Box", "class", "global", (FieldRecord("value", INT), FieldRecord("next", T_BOX))),
            ClassRecord(
                "Arm",
                "resource",
                "global",
                (FieldRecord("id", STRING), FieldRecord("hand", 7)),
                ARM_INIT,
                gripper,
            ),
            ClassRecord("Guide", "coordinator", "global", (FieldRecord("arm", T_PROXY),), GUIDE_INIT),
            ClassRecord("Tool", "class", "resource"),
        ]
        self.methods = _methods()
        self.code = [[*quads] for quads in _CODE]
        self.device_calls = [DeviceCallRecord(ARM, "hand", "Gripper", "grip", (REAL,), INT, "actuate")]
        self.sources = [SourceText("sample.L", "resource Arm {}\n")]
        self.debug = [MethodDebug(0, ((0, 1),), ((0, "this"),), f"{m.name}()") for m in self.methods]

    def change_class(self, index: int, **fields: object) -> None:
        """Replace fields of a class record."""
        self.classes[index] = msgspec.structs.replace(self.classes[index], **fields)

    def change_method(self, index: int, **fields: object) -> None:
        """Replace fields of a method record."""
        self.methods[index] = msgspec.structs.replace(self.methods[index], **fields)

    def change_device_call(self, **fields: object) -> None:
        """Replace fields of the device call."""
        self.device_calls[0] = msgspec.structs.replace(self.device_calls[0], **fields)

    def put(self, method: int, at: int, *quad: str | int) -> None:
        """Replace an instruction."""
        name, *operands = quad
        a, b, c = (*operands, 0, 0, 0)[:3]
        self.code[method][at] = (str(name), int(a), int(b), int(c))

    def core(self) -> Core:
        """The core, with entries, labels and handlers relocated."""
        quads: list[Quad] = []
        methods = []
        for method, code in zip(self.methods, self.code, strict=True):
            entry = len(quads)
            quads += [_placed(entry, *quad) for quad in code]
            handlers = tuple(
                Handler(h.start + entry, h.end + entry, h.target + entry, h.catches, h.slot)
                for h in method.handlers
            )
            methods.append(msgspec.structs.replace(method, entry=entry, end=len(quads), handlers=handlers))
        return Core(
            tuple(self.types),
            tuple(self.constants),
            tuple(self.classes),
            tuple(methods),
            tuple(self.device_calls),
            encode_quads(quads),
        )

    def program(self, core: Core | None = None) -> Program:
        """The program, before verification."""
        core = core or self.core()
        debug = [
            msgspec.structs.replace(info, lines=tuple((pc + method.entry, line) for pc, line in info.lines))
            for info, method in zip(self.debug, core.methods, strict=False)
        ]
        return Program(core, Debug(tuple(debug), tuple(self.sources)), b"")


def _placed(entry: int, name: str, a: int, b: int, c: int) -> Quad:
    jumps = name in ("jmp", "bnz", "bz")
    return Quad(BY_NAME[name].code, a + entry if jumps else a, b, c)


DraftChange = Callable[[Draft], object]


def refused(change: DraftChange, reason: str) -> None:
    """Check that the verifier refuses the changed program."""
    draft = Draft()
    change(draft)
    with pytest.raises(ProgramFileError, match=reason):
        verify(draft.program())


def put(method: int, at: int, *quad: str | int) -> DraftChange:
    return lambda draft: draft.put(method, at, *quad)


def handler(start: int, end: int, target: int, catches: int, slot: int) -> DraftChange:
    row = (Handler(start, end, target, catches, slot),)
    return lambda draft: draft.change_method(ARM_LIFT, handlers=row)
