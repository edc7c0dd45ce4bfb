"""Storage of slots during execution: WebAssembly locals, or the frame.

Locals make loops fast. But every exit writes and every point reads all locals, and the compiler takes
quadratic time to merge hundreds of these. In a long method, slots therefore stay in the frame, budget and
point in globals, and each exit returns directly: compile time is linear.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.vm.memory.layout import FRAME_SLOTS

#: Maximum parameters of a WebAssembly function, minus those of the engine.
PARAMETERS = 1000 - 2
#: The code that records the exit of a method without locals; its status is returned.
EXIT_FUNCTION = """
(func $gone (param $frame i32) (param $pc i32) (param $refund i64) (param $status i32) (result i32)
  (global.set $frame (local.get $frame))
  (global.set $pc (local.get $pc))
  (global.set $left (i64.add (global.get $left) (local.get $refund)))
  (global.set $status (local.get $status))
  (local.get $status))
"""


def slots_of(types: Sequence[str], parameters: int, result: str, *, long: bool) -> LocalSlots | FrameSlots:
    """The slots of a method by WebAssembly type; the first are its parameters."""
    if long or parameters > PARAMETERS:
        return FrameSlots(types, parameters, result)
    return LocalSlots(types, parameters)


class LocalSlots:
    """Slots as locals, read from the frame at a point and written to it at an exit."""

    #: Kind of budget and point: `local` or `global`.
    scope = "local"

    def __init__(self, types: Sequence[str], parameters: int) -> None:
        self.types, self._count = types, parameters
        #: The parameters of the function, the arguments of a caller that has none, and the locals.
        self.parameters = [f"(param $s{i} {t})" for i, t in enumerate(types[:parameters])]
        self.nothing = [f"({t}.const 0)" for t in types[:parameters]]
        self.locals = [f"(local $s{i} {t})" for i, t in enumerate(types[parameters:], parameters)]
        #: The number of values on the WebAssembly stack.
        self.stacked: int | None = len(types)
        #: The code at the entry, and at exits.
        self.entered = [
            "(local.set $left (global.get $left))",
            "(if (local.get $resume) (then",
            *(f"(local.set $s{i} {_load('$frame', i, t)})" for i, t in enumerate(types)),
            "))",
        ]
        self.written = [_store("$frame", i, t, self.value(i)) for i, t in enumerate(types)]
        #: The code after a call whose callee has not returned.
        self.followed = "(br_if $spill (local.get $status))"
        #: The code before and after a call: the budget is passed to the callee.
        self.sent, self.received = (
            "(global.set $left (local.get $left))",
            "(local.set $left (global.get $left))",
        )

    def value(self, slot: int) -> str:
        return f"(local.get $s{slot})"

    def target(self, slot: int) -> str:
        """The local for a value that goes to a slot."""
        return f"$s{slot}"

    def store_text(self, slot: int) -> str:
        """Code after that instruction."""
        return ""

    def exit_lines(self, pc: int, refund: int, status: int) -> list[str]:
        """Exits at an instruction; `refund` is the charge of instructions not executed."""
        remaining = f"(i64.add (local.get $left) (i64.const {refund}))"
        return [
            f"(global.set $pc (i32.const {pc})) (global.set $left {remaining})",
            f"(global.set $status (i32.const {status}))",
            "br $exit",
        ]

    def return_text(self, kind: str, value: str) -> str:
        """Returns a value of that type; then the branch to the end."""
        return f"(local.set $value {value})"

    def returned(self, kind: str) -> list[str]:
        """Code at that end."""
        return []

    def passed(self, arguments: list[str]) -> tuple[list[str], list[str]]:
        """Argument passing of a caller: lines that write the frame at $p, and arguments of the call."""
        return [], arguments


class FrameSlots:
    """Slots in the frame, from the call on."""

    scope = "global"

    def __init__(self, types: Sequence[str], parameters: int, result: str) -> None:
        self.types = types
        self.parameters: list[str] = []
        self.nothing: list[str] = []
        self.locals = ["(local $to_i64 i64) (local $to_f64 f64)"]
        self.stacked: int | None = None
        rest = 8 * (len(types) - parameters)
        slots_after_parameters = f"(i32.add (local.get $frame) (i32.const {_at(parameters)}))"
        self.entered = [
            "(global.set $resume (local.get $resume))",
            "(if (i32.eqz (local.get $resume))",
            f"(then (memory.fill {slots_after_parameters} (i32.const 0) (i32.const {rest}))))",
        ]
        self.written: list[str] = []
        self._returns = "return (local.get $value)" if result else "return"
        self.followed = f"(if (local.get $status) (then ({self._returns} (local.get $status))))"
        self.sent, self.received = "", ""

    def value(self, slot: int) -> str:
        return _load("$frame", slot, self.types[slot])

    def target(self, slot: int) -> str:
        """The local for a value that goes to a slot."""
        return f"$to_{self.types[slot]}"

    def store_text(self, slot: int) -> str:
        """Code after that instruction."""
        return _store("$frame", slot, self.types[slot], f"(local.get {self.target(slot)})")

    def exit_lines(self, pc: int, refund: int, status: int) -> list[str]:
        """Exits at an instruction; `refund` is the charge of instructions not executed."""
        arguments = f"(local.get $frame) (i32.const {pc}) (i64.const {refund}) (i32.const {status})"
        return [f"({self._returns} (call $gone {arguments}))"]

    def return_text(self, kind: str, value: str) -> str:
        """Returns a value of that type; then the branch to the end."""
        return f"(global.set $word {value if kind == 'i64' else f'(i64.reinterpret_f64 {value})'})"

    def returned(self, kind: str) -> list[str]:
        """Code at that end."""
        word = "(global.get $word)"
        if kind == "f64":
            word = f"(f64.reinterpret_i64 {word})"
        return [f"(local.set $value {word})"] if kind else []

    def passed(self, arguments: list[str]) -> tuple[list[str], list[str]]:
        """Argument passing of a caller: lines that write the frame at $p, and arguments of the call."""
        return [_store("$p", i, self.types[i], value) for i, value in enumerate(arguments)], []


def _at(slot: int) -> int:
    return 8 * (FRAME_SLOTS + slot)


def _load(frame: str, slot: int, kind: str) -> str:
    return f"({kind}.load offset={_at(slot)} (local.get {frame}))"


def _store(frame: str, slot: int, kind: str, value: str) -> str:
    return f"({kind}.store offset={_at(slot)} (local.get {frame}) {value})"
