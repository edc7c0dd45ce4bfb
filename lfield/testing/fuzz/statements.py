"""Random statements of L: loops, exceptions, calls, and whatever else engines must do alike."""

from __future__ import annotations

import random
from collections.abc import Callable

from lfield.testing.fuzz.coordination import Coordination
from lfield.testing.fuzz.expressions import Expressions
from lfield.testing.fuzz.tree import Piece, written

#: What can be caught, and is thrown now and then.
_CLASSES = ("Exception", "ArithmeticException", "IndexException", "NullException", "LimitException")
_CAUGHT = (
    *_CLASSES,
    *("ConversionException", "MissingReturnException", "TimeLimitException", "ReservedException"),
    *("CancelledException", "Node"),
)

#: By type, what can be written to. `#` with the types of its parts behind the last `|`.
_TARGETS: dict[str, tuple[str, ...]] = {
    "int": ("#.n|Node*", "#[#]|int[]* int", "#[0]|int[]*", "#[# % 3]|int[]* int"),
    "real": ("#.r|Node*", "#[#]|real[]* int", "#[1]|real[]*", "#[# % 3]|real[]* int"),
    "boolean": ("#.b|Node*",),
    "string": ("#.s|Node*",),
    "Node": ("#.next|Node*", "#[#]|Node[]* int", "#[1]|Node[]*"),
    "int[]": ("#.a|Node*",),
}


class Statements:
    """Draws the body of a method.

    `own` are the variables by type, `result` the type that the method gives, "" for none; `waits` are
    statements that only the machine can carry out, `asks` those that call portals.
    """

    def __init__(
        self,
        dice: random.Random,
        expressions: Expressions,
        own: dict[str, tuple[str, ...]],
        result: str,
        waits: tuple[str, ...],
        asks: tuple[str, ...],
    ) -> None:
        self.dice, self.expressions, self._own = dice, expressions, own
        self._result, self._waits, self._asks = result, waits, asks
        self._coordination = Coordination(expressions, len(asks), self.block, self.wait)
        self._loops, self._leavable, self._in_finally, self._names = 0, 0, False, 0

    def block(self, depth: int, most: int = 4) -> list[Piece]:
        """Some statements of at most so many levels."""
        return [self.statement(depth) for _ in range(self.dice.randint(1, most))]

    def statement(self, depth: int) -> Piece:
        """One statement."""
        draw = self.expressions.draw
        flat = ("assign",) * 8 + ("element",) * 3 + ("call",) * 3 + ("throw", "leave", "wait", "print")
        deep: tuple[str, ...] = (
            ("if", "if", "loop", "loop", "try", "try", "finally", "jump") if depth > 0 else ()
        )
        deep += self._coordination.choices if depth > 0 and self._asks else ()
        match chosen := self.dice.choice(flat + deep * 2):
            case "assign":
                kind = self.dice.choice(list(self._own))
                return written("", f"{self.dice.choice(self._own[kind])} = #;", draw(kind))
            case "element":
                return self._element()
            case "call":
                return self._call()
            case "throw":
                return self._throw()
            case "within" | "reserve" | "together":
                return self._coordination.draw(chosen, depth)
            case "leave":
                return self._leave()
            case "wait":
                return self.wait()
            case "print":
                return written("", "print(#);", draw(self.dice.choice(("int", "real", "boolean", "string"))))
            case "if":
                return self._if(depth)
            case "jump":
                return self._jump(depth)
            case "loop":
                return self._loop(depth)
            case "try":
                return self._try(depth, with_finally=self.dice.random() < 0.3)
        return self._finally(depth)

    def wait(self) -> Piece:
        """A statement that leaves the engine."""
        asks = self._asks * 6 if self._coordination.calls else ()
        return self.expressions.form("", self.dice.choice(self._waits + asks), 1)

    def _call(self) -> Piece:
        """Of any method: what it throws goes through its monitor, if it has one."""
        kind = self.dice.choice(list(self.expressions.calls))
        called = self.expressions.form(kind, self.dice.choice(self.expressions.calls[kind]), 1)
        return written("", f"{self.dice.choice(self._own[kind])} = #;", called)

    def _throw(self) -> Piece:
        condition = self.expressions.draw("boolean")
        if self.dice.random() < 0.3:
            return written("", "if (#) throw o0;", condition)
        name = self.dice.choice(_CLASSES)
        return written("", f"if (#) throw new {name}(#);", condition, self.expressions.draw("string", 1))

    def _element(self) -> Piece:
        kind = self.dice.choice(list(_TARGETS))
        target = self.expressions.form(kind, self.dice.choice(_TARGETS[kind]), 1)
        return written("", "# = #;", target, self.expressions.draw(kind))

    def _leave(self) -> Piece:
        """Out of a loop or the method, where that may be."""
        condition = self.expressions.draw("boolean")
        if self._leavable and self.dice.random() < 0.7:
            return written("", f"if (#) {self.dice.choice(('break', 'continue'))};", condition)
        if self._in_finally:
            return written("", "if (#) yield();", condition)
        if not self._result:
            return written("", "if (#) return;", condition)
        return written("", "if (#) return #;", condition, self.expressions.draw(self._result))

    def _if(self, depth: int) -> Piece:
        condition = self.expressions.draw("boolean")
        if self.dice.random() < 0.5:
            return written("", "if (#) { # }", condition, self.block(depth - 1))
        return written("", "if (#) { # } else { # }", condition, self.block(depth - 1), self.block(depth - 1))

    def _loop(self, depth: int, body: Callable[[], list[Piece]] | None = None) -> Piece:
        """Some rounds of a body, of a block if nothing is said."""
        body = body or (lambda: self.block(depth - 1))
        if self.dice.random() < 0.2:
            return written("", "while (#) { # }", self.expressions.draw("boolean"), self._looped(body, ""))
        name, rounds = f"k{self._loops}", self.dice.choice((2, 3, 5, 20))
        form = f"for (int {name} = 0; {name} < {rounds}; {name} = {name} + 1) {{ # }}"
        return written("", form, self._looped(body, name))

    def _looped(self, body: Callable[[], list[Piece]], counter: str) -> list[Piece]:
        self._loops += 1
        self._leavable += 1
        if counter:
            self.expressions.counters.append(counter)
        found = body()
        if counter:
            self.expressions.counters.pop()
        self._leavable -= 1
        self._loops -= 1
        return found

    def _jump(self, depth: int) -> Piece:
        """A loop that is left through what ends in order: a finally, a time limit, a reservation, calls."""

        def body() -> list[Piece]:
            which = self.dice.choice(("finally", *(self._coordination.choices if self._asks else ())))
            left = self._finally(depth) if which == "finally" else self._coordination.draw(which, depth)
            next(part for part in left.parts if isinstance(part, list)).append(self._leave())
            return [left]

        return self._loop(depth, body)

    def _try(self, depth: int, with_finally: bool) -> Piece:
        self._names += 1
        name, caught = f"e{self._names}", self.dice.choice(_CAUGHT)
        body = self.block(depth - 1)
        handler = self.block(depth - 1, 2)
        told = [f"throw {name};", ""]
        told += (
            [f"i0 = {name}.n;"]
            if caught == "Node"
            else [
                f"s0 = {name}.message();",
                f"s1 = {name}.type() + {name}.source();",
                f"i0 = {name}.others().length();",
            ]
        )
        handler.append(Piece("", [f"if (b0) {{ {self.dice.choice(told)} }}"]))
        if self.dice.random() < 0.3:
            other = f"catch (Exception {name}) {{ # }}"
            form = f"try {{ # }} catch ({caught} {name}) {{ # }} {other}"
            return written("", form, body, handler, self.block(depth - 1, 1))
        if not with_finally:
            return written("", f"try {{ # }} catch ({caught} {name}) {{ # }}", body, handler)
        return written(
            "",
            f"try {{ # }} catch ({caught} {name}) {{ # }} finally {{ # }}",
            body,
            handler,
            self._last(depth),
        )

    def _finally(self, depth: int) -> Piece:
        return written("", "try { # } finally { # }", self.block(depth - 1), self._last(depth))

    def _last(self, depth: int) -> list[Piece]:
        """The code of a finally: nothing leaves it but an exception."""
        before = self._leavable, self._in_finally
        self._leavable, self._in_finally = 0, True
        body = self.block(depth - 1, 2)
        self._leavable, self._in_finally = before
        return body
