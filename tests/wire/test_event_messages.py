"""Events as messages: encoding and decoding, fields by name in JSON, and bounds."""

import json
import math

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.errors import WireError
from lfield.wire import events
from lfield.wire.codec import decode, encode
from lfield.wire.events import KINDS, TELEMETRY, Event
from lfield.wire.fields import MAX_TEXT
from lfield.wire.framing import HEADER_SIZE
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import MAX_EVENTS, EventAck, EventBatch, Subscribe, as_fields

REPEATABLE = settings(derandomize=True, deadline=None)
DEPARTURE = events.MigrationStarted("Tour:one", 1, 7, "b", "gate", "pass", 1424)
ARRIVAL = events.MigrationArrived("Tour:one", 1, 7, "a", 1424)
STATUS = Status("a", "a:1", 0.5, b"h" * 32, b"h" * 32, [], [], [], [], [])

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=128)
SECONDS = st.floats(0.0, 1e9)
BY_TYPE = {
    "Name": TEXTS,
    "OptionalName": st.just("") | TEXTS,
    "Text": TEXTS,
    "Label": TEXTS,
    "Count": st.integers(0, 2**63 - 1),
    "Ordinal": st.integers(0, 2**62),
    "Duration": SECONDS,
    "Duration | None": SECONDS | st.none(),
    "Share | None": st.floats(0.0, 1.0) | st.none(),
    "Count | None": st.integers(0, 2**63 - 1) | st.none(),
    "bool": st.booleans(),
    "Outcome": st.sampled_from(["done", "died", "lost", "superseded"]),
    "Literal['log', 'out']": st.sampled_from(["log", "out"]),
    "Literal['done', 'thrown', 'lost']": st.sampled_from(["done", "thrown", "lost"]),
    "Annotated[dict[Label, Telemetry], Meta(max_length=1024)]": st.dictionaries(
        TEXTS, st.booleans() | st.integers(-9, 9) | SECONDS | TEXTS | st.lists(SECONDS, max_size=4)
    ),
}
#: The content of any event, generated from the fields of its class.
EVENT_CONTENTS = st.one_of(
    [
        st.builds(kind, *(BY_TYPE[kind.__annotations__[f].replace('"', "'")] for f in kind.__struct_fields__))
        for kind in KINDS.values()
    ]
)
EVENTS = st.builds(Event, st.integers(0, 2**62), SECONDS, SECONDS, st.integers(0, 2**62), EVENT_CONTENTS)


def restored(message):
    frame = encode(message)
    return decode(frame[HEADER_SIZE - 1], frame[HEADER_SIZE:])


def batch(*entries, **changes):
    return msgspec.structs.replace(EventBatch(5, 1, 1.7e9, 2.5, 0, len(entries), list(entries)), **changes)


@REPEATABLE
@given(st.lists(EVENTS, max_size=8), st.dictionaries(TEXTS, st.integers(0, 2**63 - 1), max_size=4))
def test_each_event_is_restored(entries, lost):
    message = batch(*entries, lost=lost)
    assert restored(message) == message


@pytest.mark.parametrize(
    "message", [Subscribe(), Subscribe(2**63 - 1, 2**62, 20.0), EventAck(3), batch(), batch(snapshot=STATUS)]
)
def test_messages_of_a_subscription_are_restored(message):
    assert restored(message) == message


@REPEATABLE
@given(EVENTS)
def test_json_has_every_field_by_its_name(event):
    entries = json.loads(msgspec.json.encode(as_fields(event)))
    assert KINDS[entries["kind"]] is type(event.what)
    assert entries.keys() == {"number", "at", "up", "cause", "kind", *event.what.__struct_fields__}


def test_an_event_in_json_is_flat():
    assert as_fields(Event(9, 1.5e9, 3.25, 8, DEPARTURE)) == {
        "number": 9,
        "at": 1.5e9,
        "up": 3.25,
        "cause": 8,
        "kind": "left",
        "agent": "Tour:one",
        "generation": 1,
        "sequence": 7,
        "to": "b",
        "resource": "gate",
        "portal": "pass",
        "size": 1424,
    }


def test_only_repeated_reports_are_telemetry():
    assert {"measured", "standing", "path"} == TELEMETRY
    assert KINDS.keys() > TELEMETRY


def test_no_event_has_a_field_with_a_common_name():
    common_names = {*Event.__struct_fields__, "kind", "host"} - {"what"}
    for kind in KINDS.values():
        assert common_names.isdisjoint(kind.__struct_fields__), kind


@pytest.mark.parametrize(
    "message",
    [
        Subscribe(-1),
        Subscribe(1, 2**62 + 1),
        Subscribe(telemetry=-1.0),
        Subscribe(telemetry=math.nan),
        Subscribe(telemetry=20.5),
        EventAck(-1),
        batch(*[Event(1, 1.0, 1.0, 0, ARRIVAL)] * (MAX_EVENTS + 1)),
        batch(Event(-1, 1.0, 1.0, 0, ARRIVAL)),
        batch(Event(1, math.nan, 1.0, 0, ARRIVAL)),
        batch(Event(1, 1.0, -1.0, 0, ARRIVAL)),
        batch(Event(1, 1.0, 1.0, 0, events.LineLogged("x" * (MAX_TEXT + 1)))),
        batch(Event(1, 1.0, 1.0, 0, events.MigrationArrived("", 1, 1, "a", 1))),
        batch(Event(1, 1.0, 1.0, 0, events.AgentFinished("one", 1, "asleep"))),
        batch(Event(1, 1.0, 1.0, 0, events.DeviceTelemetry("one.fc", {"at": None}, 0.5))),
        batch(Event(1, 1.0, 1.0, 0, STATUS)),
        batch(lost={"left": -1}),
        batch(now=math.inf),
    ],
)
def test_an_event_message_with_a_value_out_of_bounds_is_refused(message):
    with pytest.raises(WireError):
        restored(message)
