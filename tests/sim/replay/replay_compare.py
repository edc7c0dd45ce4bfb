"""The recording and the fake side by side: the relevant differences.

Each has a key, which identifies the difference (it contains the time of the input, never a value measured on
the fake), and a readable detail. The tolerances are in the constants; they are the spread of the recordings
themselves where one event was recorded several times.
"""

from __future__ import annotations

import ast
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from replay_fields import fields, messages
from replay_player import IDS, Played, is_motion
from replay_services import services
from replay_table import Difference, Figures, once
from replay_trace import PRE_ARM, Line, Trace

from lfield_sim.autopilot.autopilot import FLAVOURS
from lfield_sim.autopilot.flavours import MavResult

#: Seconds: heartbeats are sent at 1 Hz, so two recordings of one event differ by up to 1.0 (0.0 to 1.0
#: on ArduPilot, 0.5 to 1.0 on PX4), and the failsafe delays vary by 0.3 (1.3 to 1.6, 6.6 to 7.1).
STATE_TIME, STATE_SHARE = 1.4, 0.1
#: Texts are sent with a state or an input; some wait for the next second.
TEXT_TIME = 2.0
#: A wait for the fake of up to a second is no difference.
HOLD_TIME = 1.0
#: Acknowledgements: 0.001 to 0.03 of one loop, 0.1 for what waits for the next 10 Hz, 0.3 when the computer
#: was busy.
ACK_TIME = 0.35
#: Top speeds of a repeated leg differ by 0.1 of 3 m/s (ArduCopter) and 0.2 of 4.3 (PX4); distances likewise.
SPEED, SPEED_SHARE, DISTANCE, DISTANCE_SHARE = 0.3, 0.12, 1.0, 0.12
#: Heights hover within 0.3 (ArduCopter); PX4's home moves under them by 1 m.
HEIGHT, HEADING = 0.8, 15.0
#: Of rates: a window of 6 to 10 s counts one message more or less.
RATE, RATE_SHARE = 0.17, 0.15
#: First times after a cold start: HOME_POSITION 20.05 to 20.1, LOCAL_POSITION_NED 42.0 to 42.1, PX4's bit 4.4
#: to 6.0.
FIRST_TIME, FIRST_SHARE = 1.7, 0.02


def differences(real: Trace, played: Played) -> list[Difference]:
    """All differences of one recording, each key once, in the order of time."""
    comparisons: list[Callable[[Trace, Played], Iterator[Difference]]] = [
        _holds, _acknowledgements, _texts, _states, _motions, _firsts, _rates, _came, _heights,
    ]  # fmt: skip
    found = [each for compare in comparisons for each in compare(real, played)]
    found += fields(real, played.trace, _mode_name(real))
    found += messages(real, played.counts)
    return once([*found, *services(real, played.trace)])


def _holds(_: Trace, played: Played) -> Iterator[Difference]:
    for t, seconds, what in played.holds:
        yield Difference(f"{t:.1f} not {what} yet", figures=Figures(None, seconds, HOLD_TIME))


# -- acknowledgements ------------------------------------------------------------------------------------


def _acknowledgements(real: Trace, played: Played) -> Iterator[Difference]:
    commands = [line for line in real.inputs if line.type.startswith("COMMAND_")]
    for number, line in enumerate(commands):
        same = (c.t for c in commands[number + 1 :] if c.fields["command"] == line.fields["command"])
        end = min(next(same, math.inf), line.t + 8.0)
        real_values, simulated_values = _acks(real, line, end), _acks(played.trace, line, end)
        real_results, fake_results = _describe(real_values), _describe(simulated_values)
        what = f"{line.t:.1f} {_call(line)}"
        if real_results != fake_results:
            yield Difference(f"{what}: {real_results} / {fake_results}")
        elif real_values and abs(real_values[0].t - simulated_values[0].t) > ACK_TIME:
            times = Figures(real_values[0].t - line.t, simulated_values[0].t - line.t, ACK_TIME)
            yield Difference(f"{what}: time of the acknowledgement", figures=times)


def _acks(trace: Trace, line: Line, end: float) -> list[Line]:
    # The fake's clock moves in steps of 0.02 s: its answer to an input may be a step older than the input.
    for since in (line.t, line.t - 0.021):
        acks = trace.between(since, end, "COMMAND_ACK")
        if found := [ack for ack in acks if ack.fields["command"] == line.fields["command"]]:
            return found
    return []


def _describe(acks: list[Line]) -> str:
    words = [MavResult(int(ack.get("result"))).name for ack in acks]
    return ", ".join(word for n, word in enumerate(words) if n == 0 or word != words[n - 1]) or "no answer"


def _call(line: Line) -> str:
    """A command with its identifying parameters."""
    values = (
        [line.get(f"param{n}") for n in range(1, 6)] if line.type == "COMMAND_LONG" else [line.get("param1")]
    )
    while values and (values[-1] == 0.0 or math.isnan(values[-1])):
        values.pop()
    return f"command {line.fields['command']}({', '.join(f'{v:g}' for v in values)})"


# -- texts -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Text:
    """A status text: time, text with numbers as # and chunks joined, severity."""

    t: float
    text: str
    severity: int


def texts(trace: Trace) -> list[Text]:
    """All status texts of a recording."""
    found: list[Text] = []
    last = 0
    for line in trace.out("STATUSTEXT"):
        text, number = str(line.fields["text"]), int(line.fields.get("id") or 0)
        if number and number == last and line.fields.get("chunk_seq"):
            found[-1] = replace(found[-1], text=found[-1].text + text)
        else:
            found.append(Text(line.t, text, int(line.fields["severity"])))
        last = number
    return [replace(each, text=re.sub(r"-?\d+(\.\d+)?", "#", each.text).strip()) for each in found]


def _texts(real: Trace, played: Played) -> Iterator[Difference]:
    own, simulated_values = texts(real), texts(played.trace)
    missing: Counter[str] = Counter()
    for each in own:
        timeout = TEXT_TIME + STATE_SHARE * min(each.t - _input_before(real, each.t), 40.0)
        near = [one for one in simulated_values if one.text == each.text and abs(one.t - each.t) <= timeout]
        if not near:
            missing[each.text] += 1
            continue
        same = min(near, key=lambda one: abs(one.t - each.t))
        simulated_values.remove(same)
        if same.severity != each.severity:
            yield Difference(f"text's severity: {each.text}: {each.severity} / {same.severity}")
    text_counts = Counter(each.text for each in own)
    for text, count in missing.items():
        yield Difference(
            f"text missing: {text}",
            figures=Figures(text_counts[text], text_counts[text] - count, 0.0, "times"),
        )
    for text, count in Counter(each.text for each in simulated_values).items():
        same_text = text_counts[text] - missing[text]
        yield Difference(
            f"text too many: {text}", figures=Figures(same_text, same_text + count, 0.0, "times")
        )


def _input_before(trace: Trace, t: float) -> float:
    """The time of the last input that may have had an effect."""
    times = [line.t for line in trace.inputs if line.t <= t and line.fields.get("command") not in (511, 512)]
    return max(times, default=0.0)


# -- states ----------------------------------------------------------------------------------------------


def _states(real: Trace, played: Played) -> Iterator[Difference]:
    mode = _mode_name(real)
    for field, kind, value in (
        ("mode", "HEARTBEAT", lambda m: mode(m.fields["custom_mode"])),
        ("armed", "HEARTBEAT", lambda m: bool(int(m.get("base_mode")) & 128)),
        ("system_status", "HEARTBEAT", lambda m: m.fields["system_status"]),
        ("landed_state", "EXTENDED_SYS_STATE", lambda m: m.fields["landed_state"]),
        ("breach_status", "FENCE_STATUS", lambda m: m.fields["breach_status"]),
        ("pre-arm bit", "SYS_STATUS", lambda m: bool(int(m.get("onboard_control_sensors_health")) & PRE_ARM)),
        ("mode of CURRENT_MODE", "CURRENT_MODE", lambda m: mode(m.fields["custom_mode"])),
        ("intended mode", "CURRENT_MODE", lambda m: mode(m.fields["intended_custom_mode"])),
        ("current item", "MISSION_CURRENT", lambda m: m.fields["seq"]),
        ("total of items", "MISSION_CURRENT", lambda m: m.fields["total"]),
        ("mission_state", "MISSION_CURRENT", lambda m: m.fields["mission_state"]),
    ):
        real_values, simulated_values = (_changes(trace, kind, value) for trace in (real, played.trace))
        if bool(real_values) != bool(simulated_values):
            yield Difference(f"{field}: {'is not reported' if real_values else 'is reported'}")
        yield from _apart(real, field, real_values, simulated_values)


def _changes(trace: Trace, kind: str, value: Callable[[Line], object]) -> list[tuple[float, object]]:
    found: list[tuple[float, object]] = []
    for line in trace.out(kind):
        if not found or found[-1][1] != value(line):
            found.append((line.t, value(line)))
    return found


def _apart(
    real: Trace, field: str, ours: list[tuple[float, object]], theirs: list[tuple[float, object]]
) -> Iterator[Difference]:
    """The times in which two histories of one field differ for longer than the tolerance."""
    if not ours or not theirs:
        return
    since = max(ours[0][0], theirs[0][0])
    times = sorted({t for t, _ in [*ours, *theirs] if t > since} | {since, real.end})
    open_span: tuple[float, object, object] | None = None
    for t in times:
        pair = _at(ours, t), _at(theirs, t)
        if open_span and (t == times[-1] or pair != open_span[1:]):
            start, real_value, other = open_span
            if t - start > STATE_TIME + STATE_SHARE * min(start - _input_before(real, start), 40.0):
                when = _input_before(real, start)
                yield Difference(
                    f"{when:.1f} {field}: {real_value} / {other}",
                    f"from {start:.1f} to {t:.1f}",
                    Figures(None, t - start, STATE_TIME),
                )
            open_span = None
        if open_span is None and pair[0] != pair[1]:
            open_span = t, *pair


def _at(history: list[tuple[float, object]], t: float) -> object:
    return [value for at, value in history if at <= t][-1]


def _mode_name(trace: Trace) -> Callable[[object], str]:
    kind = FLAVOURS["px4" if trace.px4 else "ardupilot"][str(trace.header["vehicle"])]
    return lambda number: kind.mode_name(int(str(number))) or str(number)


# -- motions ---------------------------------------------------------------------------------------------


def _motions(real: Trace, played: Played) -> Iterator[Difference]:
    """Top speed, distance, height and heading between two motion inputs."""
    moves = [line.t for line in real.inputs if is_motion(line)]
    for start, end in itertools.pairwise([*moves, real.end]):
        if end - start < 1.5:
            continue
        real_values, simulated_values = (
            trace.between(start, end, "LOCAL_POSITION_NED") for trace in (real, played.trace)
        )
        if len(real_values) < 4 or len(simulated_values) < 4:
            continue
        for what, measure, slack, share, unit in (
            ("top speed", _top_speed, SPEED, SPEED_SHARE, "m/s"),
            ("way", _way, DISTANCE, DISTANCE_SHARE, "m"),
            ("climb", _climb, HEIGHT, DISTANCE_SHARE, "m"),
        ):
            a, b = measure(real_values), measure(simulated_values)
            if abs(a - b) > slack + share * abs(a):
                yield Difference(f"{start:.1f} {what}", figures=Figures(a, b, slack, unit))
        yield from _turn(real, played.trace, start, end)


def _top_speed(lines: list[Line]) -> float:
    return max(math.hypot(line.get("vx"), line.get("vy")) for line in lines)


def _way(lines: list[Line]) -> float:
    first, last = lines[0], lines[-1]
    return math.hypot(last.get("x") - first.get("x"), last.get("y") - first.get("y"))


def _climb(lines: list[Line]) -> float:
    return lines[0].get("z") - lines[-1].get("z")


def _turn(real: Trace, fake: Trace, start: float, end: float) -> Iterator[Difference]:
    """The turned angle, where ATTITUDE was requested."""
    turns = []
    for trace in (real, fake):
        lines = trace.between(start, end, "ATTITUDE")
        if len(lines) < 4:
            return
        steps = itertools.pairwise(lines)
        turns.append(sum(math.remainder(b.get("yaw") - a.get("yaw"), math.tau) for a, b in steps))
    real_values, simulated_values = (math.degrees(turn) for turn in turns)
    apart = math.remainder(simulated_values - real_values, 360.0)
    if abs(apart) > HEADING + DISTANCE_SHARE * min(abs(real_values), 180.0):
        yield Difference(
            f"{start:.1f} turn", figures=Figures(real_values, real_values + apart, HEADING, "degrees")
        )


# -- data that only some recordings have------------------------------------------------------------------


def _firsts(real: Trace, played: Played) -> Iterator[Difference]:
    """Cold starts: the first time of each report."""
    if not real.scenario.startswith("a-"):
        return
    for what, kind, is_so in (
        ("HEARTBEAT", "HEARTBEAT", lambda m: True),
        ("GPS fix", "GPS_RAW_INT", lambda m: m.get("fix_type") >= 3),
        ("HOME_POSITION", "HOME_POSITION", lambda m: True),
        ("GPS_GLOBAL_ORIGIN", "GPS_GLOBAL_ORIGIN", lambda m: True),
        ("GLOBAL_POSITION_INT", "GLOBAL_POSITION_INT", lambda m: True),
        ("LOCAL_POSITION_NED", "LOCAL_POSITION_NED", lambda m: True),
        ("EKF position", "EKF_STATUS_REPORT", lambda m: bool(int(m.get("flags")) & 0x10)),
        ("pre-arm bit", "SYS_STATUS", lambda m: bool(int(m.get("onboard_control_sensors_health")) & PRE_ARM)),
    ):
        a, b = real.first(kind, is_so), played.trace.first(kind, is_so)
        if (a is None) != (b is None):
            yield Difference(f"first {what}: is {'not ' if a is None else ''}told")
        elif a and b and abs(a - b) > FIRST_TIME + FIRST_SHARE * a:
            yield Difference(f"first {what}", figures=Figures(a, b, FIRST_TIME))


def _rates(real: Trace, played: Played) -> Iterator[Difference]:
    """Messages per second of each type, in the recorder's windows."""
    for note in real.notes:
        head, found = note.text, re.search(r"(\{'.*\})$", note.text)
        if not head.startswith("FACT") or not real.scenario.startswith("k-") or not found:
            continue
        noted: dict[str, float] = ast.literal_eval(found.group(1).rpartition(", then ")[2] or found.group(1))
        seconds = _window(head)
        for kind in sorted({*noted, *(played.counts if len(noted) > 5 or "nothing sent" in head else ())}):
            if kind in ("PARAM_VALUE", "STATUSTEXT", "COMMAND_ACK"):
                continue
            counted = sum(note.t - seconds <= t < note.t for t in played.counts.get(kind, ())) / seconds
            rate = noted.get(kind, 0.0)
            if abs(rate - counted) > RATE + RATE_SHARE * rate:
                rates = Figures(rate, counted, RATE, "a second")
                yield Difference(f"{note.t:.0f} rate of {kind}", figures=rates)


def _window(text: str) -> float:
    """The length of the recorder's window (`k-streams` in its scripts)."""
    if "10 s" in text:
        return 10.0
    return 6.0 if "interval -1" in text or "heartbeats off" in text else 8.0


def _came(real: Trace, played: Played) -> Iterator[Difference]:
    """Whether the message requested by REQUEST_MESSAGE was sent."""
    for note in real.notes:
        found = re.match(
            r"FACT REQUEST_MESSAGE (\d+) (\S+).*: \w[\w ]* after ([\d.]+) s, (\d+) came", note.text
        )
        if not found:
            continue
        kind, came = IDS.get(int(found.group(1)), ""), int(found.group(4)) > 0
        start = note.t - 0.3 - float(found.group(3)) - 0.02
        fake = any(start <= t < note.t for t in played.counts.get(kind, ()))
        if came != fake:
            yield Difference(f"{note.t:.1f} {kind}: {'came' if came else 'did not come'}")


def _heights(real: Trace, played: Played) -> Iterator[Difference]:
    """Home and heights: their drift in a minute, and the position of home in the local frame."""
    if not real.scenario.startswith("i-"):
        return
    for note in real.notes:
        seconds = re.search(r", (\d+) s: HOME_POSITION", note.text)
        start = note.t - float(seconds.group(1)) if seconds else note.t - 1.0
        for what, kind, value, slack in (
            ("home's altitude", "HOME_POSITION", lambda m: m.get("altitude") / 1000, 0.4),
            ("relative_alt", "GLOBAL_POSITION_INT", lambda m: m.get("relative_alt") / 1000, 0.6),
            ("-z", "LOCAL_POSITION_NED", lambda m: -m.get("z"), 0.6),
        ):
            a, b = (_spread(trace.between(start, note.t, kind), value) for trace in (real, played.trace))
            if seconds and a is not None and b is not None and abs(a - b) > slack + 0.4 * a:
                yield Difference(f"{note.t:.0f} {what} moves", figures=Figures(a, b, slack, "m"))
        yield from _home(real, played.trace, note.t)


def _spread(lines: list[Line], value: Callable[[Line], float]) -> float | None:
    values = [value(line) for line in lines]
    return max(values) - min(values) if values else None


def _home(real: Trace, fake: Trace, t: float) -> Iterator[Difference]:
    real_values, simulated_values = real.last("HOME_POSITION", t), fake.last("HOME_POSITION", t)
    high, low = real.last("GLOBAL_POSITION_INT", t), fake.last("GLOBAL_POSITION_INT", t)
    if real_values is None or simulated_values is None or high is None or low is None:
        return
    for axis, slack in (("x", 1.0), ("y", 1.0), ("z", 1.5)):
        a, b = real_values.get(axis), simulated_values.get(axis)
        if abs(a - b) > slack:
            yield Difference(f"{t:.0f} home's {axis}", figures=Figures(a, b, slack, "m"))
    a, b = high.get("relative_alt") / 1000, low.get("relative_alt") / 1000
    if abs(a - b) > 2.0:
        yield Difference(f"{t:.0f} relative_alt", figures=Figures(a, b, 2.0, "m"))
