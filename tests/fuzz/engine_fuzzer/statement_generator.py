"""Random statements of L that engines must execute in the same way: loops, exceptions, calls and others."""

from __future__ import annotations

import random
from collections.abc import Callable

from engine_fuzzer.coordination import Coordination
from engine_fuzzer.expression_generator import ExpressionGenerator
from engine_fuzzer.program_tree import ProgramPiece, written

#: Exception classes to catch, and sometimes to throw.
_CLASSES = ("Exception", "ArithmeticException", "IndexException", "NullException", "LimitException")
_CAUGHT = (
    *_CLASSES,
    *("ConversionException", "MissingReturnException", "TimeLimitException", "ReservedException"),
    *("CancelledException", "Node"),
)

#: Assignable forms by type: each `#` is a part, with its types after the last `|`.
_TARGETS: dict[str, tuple[str, ...]] = {
    "int": ("#.n|Node*", "#[#]|int[]* int", "#[0]|int[]*", "#[# % 3]|int[]* int"),
    "real": ("#.r|Node*", "#[#]|real[]* int", "#[1]|real[]*", "#[# % 3]|real[]* int"),
    "boolean": ("#.b|Node*",),
    "Node": ("#.next|Node*", "#[#]|Node[]* int", "#[1]|Node[]*"),
    "int[]": ("#.a|Node*",),
    "string": ("#.s|Node*", "#[#]|string[]* int", "#[0]|string[]*"),
}
#: Statements that change the length of an array, or sort it; loops exceed several capacities.
_GROWING = (
    *("#.append(#);|int[]* int", "#.append(#);|real[]* real", "#.append(#);|Node[]* Node"),
    *("#.insert(#, #);|int[]* int int", "#.insert(0, #);|real[]* real", "#.insert(1, #);|Node[]* Node"),
    *("#.pop();|int[]*", "#.remove(#);|real[]* int", "#.sort();|int[]*", "#.sort();|real[]*"),
    *("#.sort(before);|Node[]*", "#.sort(key);|Node[]*", "#.a.append(#);|Node* int"),
    # The comparison and the key may throw.
    *("#.sort(torn);|Node[]*", "#.sort(part);|Node[]*"),
    *("#.append(#);|string[]* string", "#.insert(#, #);|string[]* int string", "#.sort();|string[]*"),
    *(
        "m0[#] = #;|string int",
        "m0[#] += #;|string int",
        "m1[#] = #;|int Node",
        "m1 = new map<int, Node>();|",
    ),
    *("m2[#] = #;|string int[]", "m2[#].append(#);|string int", "m2[#] = #.slice(0, 1);|string int[]!"),
    *("for (string k6 : m0) s1 = s1 + k6;|", "for (int k6 : m1) i1 = i1 + k6;|", "q0 = m1.values();|"),
    # A loop visits the keys of a map at its start.
    *("for (string k6 : m0) i0 = i0 + m0.remove(k6);|", "for (int k6 : m1) if (#) m1.remove(k6);|boolean"),
    *("for (int k6 : m1) m1[k6 * 3 - 1] = #;|Node", "for (string k6 : m2) m2[k6].append(m2.length());|"),
    *("for (string k6 : #) m0[k6] = i1;|string[]!", "for (Node k6 : #) i2 += k6.n;|Node[]!"),
    *("for (real k6 : #) r0 += k6;|real[]!", "for (int k6 : #) m2[i2s(k6 % 4)] = #;|int[]! int[]"),
    "for (int k7 = 0; k7 < 9; k7 = k7 + 1) m0[i2s(k7 * #)] = k7;|int",
    "for (int k7 = 0; k7 < 9; k7 = k7 + 1) m1[k7 * #] = #;|int Node",
    "for (int k7 = 0; k7 < 9; k7 = k7 + 1) #.append(k7 + #);|int[]* int",
    "for (int k7 = 0; k7 < 9; k7 = k7 + 1) #.insert(#, i2f(k7));|real[]* int",
)


#: Assignment operators by type.
_ASSIGNMENTS = {
    "int": ("=", "=", "=", "+=", "-=", "*=", "/=", "%="),
    "real": ("=", "=", "=", "+=", "-=", "*=", "/=", "%="),
    "string": ("=", "=", "+="),
}


class StatementGenerator:
    """Draws the body of a method.

    `own` are the variables by type, `result` is the result type of the method, or "". `waits` are statements
    that leave the engine, `asks` statements with portal calls.
    """

    def __init__(
        self,
        rng: random.Random,
        expressions: ExpressionGenerator,
        own: dict[str, tuple[str, ...]],
        result: str,
        waits: tuple[str, ...],
        asks: tuple[str, ...],
    ) -> None:
        self.rng, self.expressions, self._own = rng, expressions, own
        self._result, self._waits, self._asks = result, waits, asks
        self._coordination = Coordination(expressions, len(asks), self.block, self.wait)
        self._loops, self._leavable, self._in_finally, self._names = 0, 0, False, 0

    def block(self, depth: int, most: int = 4) -> list[ProgramPiece]:
        """Draw statements with a maximum depth."""
        return [self.statement(depth) for _ in range(self.rng.randint(1, most))]

    def statement(self, depth: int) -> ProgramPiece:
        """Draw one statement."""
        draw = self.expressions.draw
        flat = ("grow",) * (4 * self.expressions.grows)
        flat += ("assign",) * 8 + ("element",) * 3 + ("call",) * 3 + ("throw", "leave", "wait", "print")
        deep: tuple[str, ...] = (
            ("if", "if", "loop", "loop", "try", "try", "finally", "jump") if depth > 0 else ()
        )
        deep += self._coordination.choices if depth > 0 and self._asks else ()
        match chosen := self.rng.choice(flat + deep * 2):
            case "assign":
                kind = self.rng.choice(list(self._own))
                sign = self.rng.choice(_ASSIGNMENTS.get(kind, ("=",)))
                return written("", f"{self.rng.choice(self._own[kind])} {sign} #;", draw(kind))
            case "element":
                return self._element()
            case "grow":
                return self.expressions.form("", self.rng.choice(_GROWING), 1)
            case "call":
                return self._call()
            case "throw":
                return self._throw()
            case "within" | "reserve" | "together" | "futures":
                return self._coordination.draw(chosen, depth)
            case "leave":
                return self._leave()
            case "wait":
                return self.wait()
            case "print":
                return written("", "print(#);", draw(self.rng.choice(("int", "real", "boolean", "string"))))
            case "if":
                return self._if(depth)
            case "jump":
                return self._jump(depth)
            case "loop":
                return self._loop(depth)
            case "try":
                return self._try(depth, with_finally=self.rng.random() < 0.3)
        return self._finally(depth)

    def wait(self) -> ProgramPiece:
        """Draw a statement that leaves the engine."""
        asks = self._asks * 6 if self._coordination.calls else ()
        return self.expressions.form("", self.rng.choice(self._waits + asks), 1)

    def _call(self) -> ProgramPiece:
        """A call of any method, possibly synchronized, whose exceptions leave its monitor."""
        kind = self.rng.choice(list(self.expressions.calls))
        called = self.expressions.form(kind, self.rng.choice(self.expressions.calls[kind]), 1)
        return written("", f"{self.rng.choice(self._own[kind])} = #;", called)

    def _throw(self) -> ProgramPiece:
        condition = self.expressions.draw("boolean")
        if self.rng.random() < 0.3:
            return written("", "if (#) throw o0;", condition)
        name = self.rng.choice(_CLASSES)
        return written("", f"if (#) throw new {name}(#);", condition, self.expressions.draw("string", 1))

    def _element(self) -> ProgramPiece:
        kind = self.rng.choice(list(_TARGETS))
        target = self.expressions.form(kind, self.rng.choice(_TARGETS[kind]), 1)
        return written("", "# = #;", target, self.expressions.draw(kind))

    def _leave(self) -> ProgramPiece:
        """A jump out of a loop or the method, where it is valid."""
        condition = self.expressions.draw("boolean")
        if self._leavable and self.rng.random() < 0.7:
            return written("", f"if (#) {self.rng.choice(('break', 'continue'))};", condition)
        if self._in_finally:
            return written("", "if (#) yield();", condition)
        if not self._result:
            return written("", "if (#) return;", condition)
        return written("", "if (#) return #;", condition, self.expressions.draw(self._result))

    def _if(self, depth: int) -> ProgramPiece:
        condition = self.expressions.draw("boolean")
        if self.rng.random() < 0.5:
            return written("", "if (#) { # }", condition, self.block(depth - 1))
        return written("", "if (#) { # } else { # }", condition, self.block(depth - 1), self.block(depth - 1))

    def _loop(self, depth: int, body: Callable[[], list[ProgramPiece]] | None = None) -> ProgramPiece:
        """A loop with some rounds of a body; the default body is a block."""
        body = body or (lambda: self.block(depth - 1))
        if self.rng.random() < 0.2:
            return written("", "while (#) { # }", self.expressions.draw("boolean"), self._looped(body, ""))
        name, rounds = f"k{self._loops}", self.rng.choice((2, 3, 5, 20))
        if self.expressions.grows and self.rng.random() < 0.3:
            each = self.expressions.form("int[]", "#|int[]*", 1)
            return written("", f"for (int {name} : #) {{ # }}", each, self._looped(body, name))
        form = f"for (int {name} = 0; {name} < {rounds}; {name} = {name} + 1) {{ # }}"
        return written("", form, self._looped(body, name))

    def _looped(self, body: Callable[[], list[ProgramPiece]], counter: str) -> list[ProgramPiece]:
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

    def _jump(self, depth: int) -> ProgramPiece:
        """A loop with an exit through a finally, a time limit, a reservation, or running calls."""

        def body() -> list[ProgramPiece]:
            which = self.rng.choice(("finally", *(self._coordination.choices if self._asks else ())))
            left = self._finally(depth) if which == "finally" else self._coordination.draw(which, depth)
            next(part for part in left.parts if isinstance(part, list)).append(self._leave())
            return [left]

        return self._loop(depth, body)

    def _try(self, depth: int, with_finally: bool) -> ProgramPiece:
        self._names += 1
        name, exception = f"e{self._names}", self.rng.choice(_CAUGHT)
        body = self.block(depth - 1)
        handler = self.block(depth - 1, 2)
        lines = [f"throw {name};", ""]
        lines += (
            [f"i0 = {name}.n;"]
            if exception == "Node"
            else [
                f"s0 = {name}.message();",
                f"s1 = {name}.type() + {name}.source();",
                f"i0 = {name}.others().length();",
            ]
        )
        handler.append(ProgramPiece("", [f"if (b0) {{ {self.rng.choice(lines)} }}"]))
        if self.rng.random() < 0.3:
            other = f"catch (Exception {name}) {{ # }}"
            form = f"try {{ # }} catch ({exception} {name}) {{ # }} {other}"
            return written("", form, body, handler, self.block(depth - 1, 1))
        if not with_finally:
            return written("", f"try {{ # }} catch ({exception} {name}) {{ # }}", body, handler)
        return written(
            "",
            f"try {{ # }} catch ({exception} {name}) {{ # }} finally {{ # }}",
            body,
            handler,
            self._last(depth),
        )

    def _finally(self, depth: int) -> ProgramPiece:
        return written("", "try { # } finally { # }", self.block(depth - 1), self._last(depth))

    def _last(self, depth: int) -> list[ProgramPiece]:
        """The body of a finally, which only an exception leaves."""
        before = self._leavable, self._in_finally
        self._leavable, self._in_finally = 0, True
        body = self.block(depth - 1, 2)
        self._leavable, self._in_finally = before
        return body
