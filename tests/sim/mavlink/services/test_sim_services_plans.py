"""The mission protocol of the fake in virtual time: both autopilots, three kinds of plan."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.mavlink.services.plan_items import PlanItem, PlanResult, PlanType
from lfield_sim.mavlink.services.plan_protocol import ARDUPILOT, HANDLED, PX4, PlanProtocol

HOME = PlanItem(16, 0, (0, 0, 0, 0), 473977420, 85455940, 488.0)
HERE = (473977420, 85455940)
STYLES = {"ardupilot": ARDUPILOT, "px4": PX4}


def waypoint(number=0, **changes):
    return replace(PlanItem(16, 6, (0, 0, 0, 0), HERE[0] + number, HERE[1], 10.0), **changes)


def corner(of, number, command=5001):
    return PlanItem(command, 0, (of, 0, 0, 0), HERE[0] + 1000 * number, HERE[1] + 1000 * (number % 2))


@pytest.fixture(params=["ardupilot", "px4"])
def style(request):
    return STYLES[request.param]


class Station:
    """A ground station that uploads plans message by message."""

    def __init__(self, style, *, system=255, vehicle=None):
        self.changes, self.texts = [], []
        self.vehicle = vehicle or PlanProtocol(style, lambda: HOME, self._changed, self.texts.append)
        self.system, self.now = system, 0.0

    def _changed(self, kind, whole):
        if whole:
            self.changes.append(kind)

    def send(self, message):
        """Sends one message in its wire form; returns the answers, all for this station."""
        packer = dialect.MAVLink(None, srcSystem=self.system, srcComponent=190)
        (received,) = dialect.MAVLink(None).parse_buffer(message.pack(packer))
        answers = self.vehicle.receive(received, self.now)
        assert all((a.target_system, a.target_component) == (self.system, 190) for a in answers)
        return answers

    def wait(self, seconds, step=0.02):
        received = []
        for _ in range(round(seconds / step)):
            self.now += step
            received += self.vehicle.advance(self.now)
        return received

    def count(self, number, kind=PlanType.MISSION):
        return self.send(dialect.MAVLink_mission_count_message(1, 1, number, int(kind)))

    def item(self, number, item, kind=PlanType.MISSION):
        return self.send(item.write((1, 1), number, kind, current=False))

    def upload(self, items, kind=PlanType.MISSION):
        """The result of an upload without losses."""
        answers = self.count(len(items), kind)
        while answers[0].get_msgId() != dialect.MAVLINK_MSG_ID_MISSION_ACK:
            answers = self.item(answers[0].seq, items[answers[0].seq], kind)
        assert answers[0].mission_type == kind
        return PlanResult(answers[0].type)

    def download(self, kind=PlanType.MISSION, *, whole=True):
        (count,) = self.send(dialect.MAVLink_mission_request_list_message(1, 1, int(kind)))
        ask = (
            dialect.MAVLink_mission_request_int_message if whole else dialect.MAVLink_mission_request_message
        )
        items = [self.send(ask(1, 1, number, int(kind)))[0] for number in range(count.count)]
        self.send(dialect.MAVLink_mission_ack_message(1, 1, 0, int(kind)))
        return items


@pytest.mark.parametrize("kind", list(PlanType))
def test_uploaded_plan_is_downloaded(style, kind):
    items = {
        PlanType.MISSION: [waypoint(n) for n in range(20)],
        PlanType.FENCE: [corner(3, n) for n in range(3)] + [PlanItem(5004, 0, (25.0, 0, 0, 0), *HERE)],
        PlanType.RALLY: [PlanItem(5100, 3, (0, 0, 0, 0), *HERE, 30.0)],
    }[kind]
    s = Station(style)
    assert s.upload(items, kind) is PlanResult.ACCEPTED
    assert s.changes == [kind]
    expected = [HOME, *items[1:]] if kind is PlanType.MISSION and style.home_first else items
    # ArduPilot has no INT frames, PX4 reports only INT frames.
    expected = [replace(item, frame=style.frames.get(item.frame, item.frame)) for item in expected]
    assert [PlanItem.read(message) for message in s.download(kind)] == expected


def test_each_autopilot_requests_items_with_its_own_message():
    (request,) = Station(ARDUPILOT).count(2)
    assert request.get_type() == "MISSION_REQUEST"
    (request,) = Station(PX4).count(2)
    assert request.get_type() == "MISSION_REQUEST_INT"


def test_items_in_degrees_are_uploaded_and_downloaded(style):
    s = Station(style)
    s.count(2)
    for number in (0, 1):
        (answer,) = s.send(
            waypoint(number).write((1, 1), number, PlanType.MISSION, current=False, whole=False)
        )
    assert answer.type == PlanResult.ACCEPTED
    item = s.download(whole=False)[1]
    assert item.get_type() == "MISSION_ITEM"
    assert item.x == pytest.approx(47.3977421, abs=4e-6)


def test_missing_item_is_requested_again_until_a_timeout(style):
    s = Station(style)
    s.count(3)
    s.item(0, waypoint())
    received = s.wait(style.timeout - 0.1)
    assert {m.seq for m in received} == {1}
    assert len(received) == pytest.approx((style.timeout - 0.1) / style.request_interval, abs=2)
    assert s.texts == []
    ends = [m for m in s.wait(style.request_interval + 0.3) if m.get_type() == "MISSION_ACK"]
    # PX4 reports it only as a text.
    assert [end.type for end in ends] == [PlanResult.OPERATION_CANCELLED] * style.cancels
    assert s.texts == [style.texts["timeout"]]
    assert s.wait(20.0) == []
    assert s.item(1, waypoint())[0].type == PlanResult.ERROR
    assert s.changes == []


def test_failed_upload_leaves_a_mixture_on_ardupilot_only():
    old = [waypoint(900 + n) for n in range(5)]
    for style, items in ((ARDUPILOT, [waypoint(0), *old[1:3]]), (PX4, old)):
        s = Station(style)
        s.upload(old)
        s.count(3)
        s.item(0, waypoint(0))
        s.wait(20.0)
        assert s.vehicle.items[PlanType.MISSION] == items
        assert len(s.download()) == len(items)
        s.count(7)
        for number in range(4):
            s.item(number, waypoint(number))
        assert s.item(4, waypoint(command=31000))[0].type == PlanResult.UNSUPPORTED
        assert len(s.download()) == (4 if style is ARDUPILOT else 5)


def test_items_out_of_sequence():
    ardupilot, px4 = Station(ARDUPILOT), Station(PX4)
    for s in (ardupilot, px4):
        s.count(5)
        s.item(0, waypoint())
        s.item(1, waypoint())
        (again,) = s.item(1, waypoint())
        assert again.seq == 2, "a repetition: the request was lost"
    assert ardupilot.item(4, waypoint())[0].type == PlanResult.INVALID_SEQUENCE
    assert ardupilot.item(2, waypoint())[0].type == PlanResult.ERROR
    assert px4.item(4, waypoint())[0].seq == 2


def test_plan_above_the_capacity_is_refused(style):
    for kind in PlanType:
        assert Station(style).count(style.capacity[kind] + 1, kind)[0].type == PlanResult.NO_SPACE
        assert Station(style).count(style.capacity[kind], kind)[0].seq == 0


def test_empty_plan_and_clear_all_remove_the_mission(style):
    for clear in (
        lambda s: s.count(0),
        lambda s: s.send(dialect.MAVLink_mission_clear_all_message(1, 1, 0)),
        lambda s: s.send(dialect.MAVLink_mission_clear_all_message(1, 1, 255)),
    ):
        s = Station(style)
        s.upload([waypoint(n) for n in range(3)])
        (answer,) = clear(s)
        assert answer.type == PlanResult.ACCEPTED
        assert s.download() == []


def test_empty_ardupilot_mission_contains_home():
    s = Station(ARDUPILOT)
    assert [PlanItem.read(m) for m in s.download()] == [HOME], "after power-on: clients wait for it"
    ask = dialect.MAVLink_mission_request_int_message(1, 1, 0, 0)
    assert [PlanItem.read(m) for m in s.send(ask)] == [HOME], "also without a list request"
    assert s.upload([waypoint()]) is PlanResult.ACCEPTED
    assert [PlanItem.read(m) for m in s.download()] == [HOME]
    s.send(dialect.MAVLink_mission_clear_all_message(1, 1, 0))
    assert s.download() == []
    assert Station(PX4).download() == []


def test_second_station_is_denied_during_an_upload(style):
    one = Station(style)
    two = Station(style, system=254, vehicle=one.vehicle)
    one.count(2)
    assert two.count(1)[0].type == PlanResult.DENIED
    assert two.item(0, waypoint(7))[0].type == PlanResult.ERROR
    assert two.send(dialect.MAVLink_mission_clear_all_message(1, 1, 0))[0].type == PlanResult.DENIED
    assert two.send(dialect.MAVLink_mission_request_list_message(1, 1, 0))[0].type == PlanResult.DENIED
    one.item(0, waypoint())
    assert one.item(1, waypoint())[0].type == PlanResult.ACCEPTED
    assert len(two.download()) == 2


def test_upload_can_be_restarted_and_cancelled(style):
    s = Station(style)
    s.count(3)
    s.item(0, waypoint())
    assert s.count(2)[0].seq == 0
    s.send(dialect.MAVLink_mission_ack_message(1, 1, PlanResult.OPERATION_CANCELLED, 0))
    assert s.wait(20.0) == []
    assert s.item(0, waypoint())[0].type == PlanResult.ERROR


@pytest.mark.parametrize(
    ("item", "result"),
    [
        (waypoint(command=31000), PlanResult.UNSUPPORTED),
        (waypoint(command=5001), PlanResult.UNSUPPORTED),
        (waypoint(frame=1), PlanResult.UNSUPPORTED_FRAME),
        (waypoint(frame=2), PlanResult.UNSUPPORTED_FRAME),
        (PlanItem(178, 2, (1, 5, -1, 0)), PlanResult.ACCEPTED),
        (waypoint(values=(math.inf, 0, 0, 0)), PlanResult.INVALID_PARAM1),
        (waypoint(values=(0, 0, -math.inf, 0)), PlanResult.INVALID_PARAM3),
        (waypoint(values=(0, 0, 0, math.nan)), PlanResult.ACCEPTED),
        (waypoint(x=910000000), PlanResult.INVALID_PARAM5_X),
        (waypoint(y=-1810000000), PlanResult.INVALID_PARAM6_Y),
        (waypoint(z=math.nan), PlanResult.INVALID_PARAM7),
        (waypoint(z=math.inf), PlanResult.INVALID_PARAM7),
    ],
)
def test_invalid_mission_item_is_refused(style, item, result):
    s = Station(style)
    assert s.upload([waypoint(), item]) is result
    assert (s.changes == []) == (result is not PlanResult.ACCEPTED)


def test_px4_accepts_nan_for_unset_parameters():
    unset = waypoint(values=(0, math.nan, math.nan, math.nan))
    assert Station(PX4).upload([unset]) is PlanResult.ACCEPTED
    assert Station(ARDUPILOT).upload([waypoint(), unset]) is PlanResult.INVALID_PARAM2


@pytest.mark.parametrize(
    "items",
    [
        [corner(2, n) for n in range(2)],
        [corner(4, n) for n in range(3)],
        [corner(3, 0), corner(3, 1), corner(4, 2)],
        [corner(3, 0), corner(3, 1), corner(3, 2, 5002)],
        [corner(math.nan, 0)],
        [PlanItem(5003, 0, (0.0, 0, 0, 0), *HERE)],
        [PlanItem(5003, 0, (-5.0, 0, 0, 0), *HERE)],
        [corner(3, 0), PlanItem(5003, 0, (5.0, 0, 0, 0), *HERE)],
    ],
)
def test_invalid_fence_is_refused(style, items):
    s = Station(style)
    result = s.upload(items, PlanType.FENCE)
    assert result not in (PlanResult.ACCEPTED, PlanResult.NO_SPACE)
    assert s.changes == []
    # A corner count of NaN is refused with its item.
    if style is ARDUPILOT and not math.isnan(items[0].values[0]):
        assert result is PlanResult.ERROR
        assert s.texts[-1] == "Fence validation failed"


def test_px4_refuses_a_two_corner_polygon_earlier_than_ardupilot():
    ardupilot, px4 = Station(ARDUPILOT), Station(PX4)
    for s in (ardupilot, px4):
        s.count(2, PlanType.FENCE)
    assert px4.item(0, corner(2, 0), PlanType.FENCE)[0].type == PlanResult.ERROR
    assert ardupilot.item(0, corner(2, 0), PlanType.FENCE)[0].seq == 1
    assert ardupilot.item(1, corner(2, 1), PlanType.FENCE)[0].type == PlanResult.ERROR
    assert "Invalid vertex count (2)" in ardupilot.texts


def test_request_for_a_missing_item_or_plan(style):
    s = Station(style)
    s.upload([waypoint(), waypoint()])
    missing = dialect.MAVLink_mission_request_int_message(1, 1, 2, 0)
    assert (s.send(missing) == []) == style.needs_list, "PX4 sends items only after a list request"
    s.send(dialect.MAVLink_mission_request_list_message(1, 1, 0))
    assert s.send(missing)[-1].type == PlanResult.INVALID_SEQUENCE
    assert s.count(1, 7)[0].type == PlanResult.UNSUPPORTED
    assert s.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) == []


one, byte, word, number = st.just(1), st.integers(0, 255), st.integers(0, 0xFFFF), st.floats(width=32)
whole = st.integers(-(1 << 31), (1 << 31) - 1)


def items_by(make, where):
    """Items with any command, frame, values and kind; the first sequence numbers of a plan."""
    head = (one, one, st.integers(0, 9), st.integers(0, 30), word, st.just(0), one)
    return st.builds(make, *head, *[number] * 4, where, where, number, st.integers(0, 3))


messages = st.one_of(
    st.builds(dialect.MAVLink_mission_count_message, one, one, word, byte),
    st.builds(dialect.MAVLink_mission_ack_message, one, one, byte, byte),
    st.builds(dialect.MAVLink_mission_clear_all_message, one, one, byte),
    st.builds(dialect.MAVLink_mission_request_list_message, one, one, byte),
    st.builds(dialect.MAVLink_mission_request_int_message, one, one, word, st.integers(0, 3)),
    items_by(dialect.MAVLink_mission_item_int_message, whole),
    items_by(dialect.MAVLink_mission_item_message, number),
)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from([ARDUPILOT, PX4]), st.lists(st.tuples(st.integers(1, 9), messages), max_size=20))
def test_random_mission_messages_do_not_raise(style, scenario):
    s = Station(style)
    for system, message in scenario:
        s.system = system
        s.send(message)
        for answer in s.wait(0.5, step=0.5):
            answer.pack(dialect.MAVLink(None))
    assert all(len(items) <= style.capacity[kind] for kind, items in s.vehicle.items.items())


@settings(max_examples=100, deadline=None)
@given(st.sampled_from([ARDUPILOT, PX4]), st.integers(1, 12), st.data())
def test_upload_over_a_lossy_link_leaves_no_wrong_mission(style, size, data):
    """A station answers every received request; a third of all packets is lost."""
    s = Station(style)
    old, new = [waypoint(900 + n) for n in range(2)], [waypoint(n) for n in range(size)]
    s.upload(old)
    lost = st.sampled_from([True, False, False])
    answers, result = s.count(size), None
    for _ in range(400):
        received = [a for a in answers + s.wait(0.3, step=0.3) if not data.draw(lost)]
        answers = []
        for message in received:
            if message.get_type() == "MISSION_ACK":
                result = message.type
            elif not data.draw(lost):
                answers += s.item(message.seq, new[message.seq])
        if s.vehicle._upload is None and not answers:
            break
    else:
        pytest.fail("the upload neither ended nor timed out")
    items = s.vehicle.items[PlanType.MISSION]
    mixed = [new[:n] + old[:size][n:] for n in range(size + 1)] if style.writes_at_once else []
    assert items in (old, new, *mixed)
    assert result != PlanResult.ACCEPTED or items == new


def test_every_message_of_the_mission_protocol_has_a_handler():
    assert sorted(HANDLED) == [39, 40, 43, 44, 45, 47, 51, 73]
