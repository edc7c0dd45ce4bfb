"""Where the slots of a method are while it runs: in locals, or in its frame all the time.

Locals make loops fast. But every way out writes all of them to the frame and every point reads them, and what
meets there from hundreds of places costs the compiler the square of their number. So in a long method they
stay in the frame, the budget and the point in globals, and each way out returns where it is: nothing meets,
and a line costs what a line costs.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.vm.memory.layout import FRAME_SLOTS

#: Parameters that a function of WebAssembly may have; two are ours.
PARAMETERS = 1000 - 2
#: Notes where a method without locals is left; its result is how, again.
GONE = """
(func $gone (param $frame i32) (param $pc i32) (param $refund i64) (param $status i32) (result i32)
  (global.set $frame (local.get $frame))
  (global.set $pc (local.get $pc))
  (global.set $left (i64.add (global.get $left) (local.get $refund)))
  (global.set $status (local.get $status))
  (local.get $status))
"""


def slots_of(types: Sequence[str], parameters: int, result: str, *, long: bool) -> Locals | Framed:
    """The slots of a method by their types in WebAssembly; the first are its parameters."""
    if long or parameters > PARAMETERS:
        return Framed(types, parameters, result)
    return Locals(types, parameters)


class Locals:
    """Each slot is a local, read from the frame at a point and written to it where the method is left."""

    #: What the budget and the point are: `local` or `global`.
    scope = "local"

    def __init__(self, types: Sequence[str], parameters: int) -> None:
        self.types, self._count = types, parameters
        #: The function's parameters, the same of a caller who has none, and its locals.
        self.parameters = [f"(param $s{i} {t})" for i, t in enumerate(types[:parameters])]
        self.nothing = [f"({t}.const 0)" for t in types[:parameters]]
        self.locals = [f"(local $s{i} {t})" for i, t in enumerate(types[parameters:], parameters)]
        #: How many are on WebAssembly's own stack.
        self.stacked: int | None = len(types)
        #: At the beginning, and where the method is left.
        self.entered = [
            "(local.set $left (global.get $left))",
            "(if (local.get $resume) (then",
            *(f"(local.set $s{i} {_load('$frame', i, t)})" for i, t in enumerate(types)),
            "))",
        ]
        self.written = [_store("$frame", i, t, self.value(i)) for i, t in enumerate(types)]
        #: Behind a call, where the callee has not returned.
        self.followed = "(br_if $spill (local.get $status))"
        #: Before and behind a call: the budget is the callee's.
        self.handed, self.taken = (
            "(global.set $left (local.get $left))",
            "(local.set $left (global.get $left))",
        )

    def value(self, slot: int) -> str:
        """What is in a slot."""
        return f"(local.get $s{slot})"

    def target(self, slot: int) -> str:
        """The local where an instruction puts what goes to a slot."""
        return f"$s{slot}"

    def kept(self, slot: int) -> str:
        """Behind that instruction."""
        return ""

    def gone(self, pc: int, refund: int, status: int) -> list[str]:
        """Leaves at an instruction; `refund` are those paid for that are not done."""
        left = f"(i64.add (local.get $left) (i64.const {refund}))"
        return [
            f"(global.set $pc (i32.const {pc})) (global.set $left {left})",
            f"(global.set $status (i32.const {status}))",
            "br $exit",
        ]

    def given(self, kind: str, value: str) -> str:
        """Where the method returns a value of that type; then the way to its end."""
        return f"(local.set $value {value})"

    def returned(self, kind: str) -> list[str]:
        """At that end."""
        return []

    def passed(self, arguments: list[str]) -> tuple[list[str], list[str]]:
        """How a caller passes arguments: lines that write the frame at $p, and what the call is given."""
        return [], arguments


class Framed:
    """Each slot is in the frame, from the call on."""

    scope = "global"

    def __init__(self, types: Sequence[str], parameters: int, result: str) -> None:
        self.types = types
        self.parameters: list[str] = []
        self.nothing: list[str] = []
        self.locals = ["(local $to_i64 i64) (local $to_f64 f64)"]
        self.stacked: int | None = None
        rest = 8 * (len(types) - parameters)
        behind = f"(i32.add (local.get $frame) (i32.const {_at(parameters)}))"
        self.entered = [
            "(global.set $resume (local.get $resume))",
            "(if (i32.eqz (local.get $resume))",
            f"(then (memory.fill {behind} (i32.const 0) (i32.const {rest}))))",
        ]
        self.written: list[str] = []
        self._returns = "return (local.get $value)" if result else "return"
        self.followed = f"(if (local.get $status) (then ({self._returns} (local.get $status))))"
        self.handed, self.taken = "", ""

    def value(self, slot: int) -> str:
        """What is in a slot."""
        return _load("$frame", slot, self.types[slot])

    def target(self, slot: int) -> str:
        """The local where an instruction puts what goes to a slot."""
        return f"$to_{self.types[slot]}"

    def kept(self, slot: int) -> str:
        """Behind that instruction."""
        return _store("$frame", slot, self.types[slot], f"(local.get {self.target(slot)})")

    def gone(self, pc: int, refund: int, status: int) -> list[str]:
        """Leaves at an instruction; `refund` are those paid for that are not done."""
        how = f"(local.get $frame) (i32.const {pc}) (i64.const {refund}) (i32.const {status})"
        return [f"({self._returns} (call $gone {how}))"]

    def given(self, kind: str, value: str) -> str:
        """Where the method returns a value of that type; then the way to its end."""
        return f"(global.set $word {value if kind == 'i64' else f'(i64.reinterpret_f64 {value})'})"

    def returned(self, kind: str) -> list[str]:
        """At that end."""
        word = "(global.get $word)"
        if kind == "f64":
            word = f"(f64.reinterpret_i64 {word})"
        return [f"(local.set $value {word})"] if kind else []

    def passed(self, arguments: list[str]) -> tuple[list[str], list[str]]:
        """How a caller passes arguments: lines that write the frame at $p, and what the call is given."""
        return [_store("$p", i, self.types[i], value) for i, value in enumerate(arguments)], []


def _at(slot: int) -> int:
    return 8 * (FRAME_SLOTS + slot)


def _load(frame: str, slot: int, kind: str) -> str:
    return f"({kind}.load offset={_at(slot)} (local.get {frame}))"


def _store(frame: str, slot: int, kind: str, value: str) -> str:
    return f"({kind}.store offset={_at(slot)} (local.get {frame}) {value})"
