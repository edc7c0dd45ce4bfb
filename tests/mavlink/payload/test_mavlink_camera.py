"""Camera protocol v2: pictures, series, video, status, refusals, and lost messages."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench

from lfield.errors import DeviceError
from lfield_mavlink.contact.components import HEARTBEAT_TIMEOUT, PayloadSources
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.packet_sources import Source
from lfield_sim.autopilot.equipment.camera import CARD, IMAGE, IMAGE_SIZE, VIDEO, VIDEO_RATE
from lfield_sim.autopilot.equipment.payload import Payload

CAMERA = dialect.MAV_COMP_ID_CAMERA
COMMAND = dialect.MAVLINK_MSG_ID_COMMAND_LONG
CAPTURED, ACK = dialect.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED, dialect.MAVLINK_MSG_ID_COMMAND_ACK


def kind_of(packet):
    return packet[7] | packet[8] << 8 | packet[9] << 16


@pytest.fixture
def filmed(bench):
    """A bench with a camera that has a component id."""

    def make(**options):
        return bench(payload=Payload(frozenset({"mavlink_camera"})), **options)

    return make


async def present(b, fc):
    await b.until(lambda: fc.components.present([CAMERA]) == [CAMERA])
    return b.autopilot.payload.camera


@on_bench("filmed", endpoint="udp:127.0.0.1:1, payload=udpin:127.0.0.1:2")
async def test_a_camera_on_a_link_of_its_own_is_commanded_there(b, fc, /):
    own = b.links[1]

    def on_its_link(link, packet):
        if (packet[6] == CAMERA) == (link is own):
            own.sender("10.0.0.9:14550")
            link.on_data(packet)

    b.filter = on_its_link
    camera = await present(b, fc)
    await fc.execute("triggerCamera", [])
    assert camera.pictures == 1
    commands = [(address, data[10 + 31]) for address, data in own.sent_to if kind_of(data) == COMMAND]
    assert commands
    assert set(commands) == {("10.0.0.9:14550", CAMERA)}
    assert {data[10 + 31] for data in b.links[0].sent if kind_of(data) == COMMAND} == {1}


def test_the_address_of_a_camera_is_used_until_its_heartbeats_are_gone():
    sources, one, other = PayloadSources([1]), Source(1, "10.0.0.9:1"), Source(1, "10.0.0.8:1")
    ids, heartbeat = (1, CAMERA), dialect.MAVLINK_MSG_ID_HEARTBEAT
    assert not sources.accepts(one, ids, ACK, 0.0)
    assert not sources.accepts(Source(0, "10.0.0.9:1"), ids, heartbeat, 0.0)
    assert sources.source(ids) is None
    assert sources.accepts(one, ids, heartbeat, 0.0)
    assert sources.accepts(one, ids, ACK, 1.0)
    assert not sources.accepts(other, ids, heartbeat, HEARTBEAT_TIMEOUT)
    assert sources.accepts(other, ids, heartbeat, HEARTBEAT_TIMEOUT + 0.1)
    assert (sources.accepts(one, ids, ACK, HEARTBEAT_TIMEOUT + 0.1), sources.source(ids)) == (False, other)


@on_bench("filmed")
async def test_a_camera_that_is_gone_is_not_replaced_by_the_autopilot(b, fc, /):
    camera = await present(b, fc)
    deliver = b.filter
    b.filter = lambda link, packet: None if packet[6] == CAMERA else deliver(link, packet)
    await asyncio.sleep(HEARTBEAT_TIMEOUT + 1.0)
    for instruction in ("triggerCamera", "stopVideo"):
        with pytest.raises(DeviceError, match=f"{instruction} refused: no heartbeat of camera 100"):
            await fc.execute(instruction, [])
    b.filter = deliver
    await present(b, fc)
    await fc.execute("triggerCamera", [])
    assert camera.pictures == 1


@on_bench("filmed", flavour="px4")
async def test_a_picture_is_done_when_the_camera_has_stored_it(b, fc, /):
    camera = await present(b, fc)
    for count in (1, 2):
        await fc.execute("triggerCamera", [])
        assert (camera.pictures, camera.used) == (count, count * IMAGE_SIZE)
    latitude, longitude, altitude = b.values["lastPicture"]
    assert (latitude, longitude, altitude) == pytest.approx((47.397742, 8.545594, 488.0), abs=1e-3)
    await b.until(lambda: b.values.get("pictures") == 2)
    assert b.values["storage"] == pytest.approx(CARD - 2 * IMAGE_SIZE)


@on_bench("filmed")
async def test_a_series_and_a_video_are_shown_by_the_status(b, fc, /):
    camera = await present(b, fc)
    await fc.execute("startPictures", [2.0, 3])
    assert camera.is_shooting
    await b.until(lambda: camera.pictures == 3)
    assert not camera.is_shooting
    await fc.execute("startPictures", [1.0, 0])
    with pytest.raises(DeviceError, match=r"startVideo refused: DENIED \(2\): it takes pictures"):
        await fc.execute("startVideo", [])
    await fc.execute("stopPictures", [])
    # The camera is in the mode for pictures: the driver changes it.
    await fc.execute("startVideo", [])
    assert (camera.mode, b.values["recording"]) == (VIDEO, True)
    with pytest.raises(DeviceError, match="it records a video; stopVideo"):
        await fc.execute("triggerCamera", [])
    await asyncio.sleep(10.0)
    await fc.execute("stopVideo", [])
    assert not b.values["recording"]
    assert camera.used - camera.pictures * IMAGE_SIZE > 9.9 * VIDEO_RATE
    await fc.execute("triggerCamera", [])
    assert camera.mode == IMAGE


@on_bench("filmed", faults=("card=12",))
async def test_a_full_card_is_named(b, fc, /):
    camera = await present(b, fc)
    await fc.execute("triggerCamera", [])
    for instruction, arguments in (("triggerCamera", []), ("startPictures", [1.0, 0]), ("startVideo", [])):
        with pytest.raises(DeviceError, match=f"{instruction} refused: .*its card is full, 4.0 MiB are left"):
            await fc.execute(instruction, arguments)
    assert camera.pictures == 1


@on_bench("filmed", faults=("camera_failure=true",))
async def test_a_picture_that_is_not_stored_is_an_error(b, fc, /):
    await present(b, fc)
    with pytest.raises(DeviceError, match="the camera stored no picture"):
        await fc.execute("triggerCamera", [])


@pytest.mark.parametrize("lost", [CAPTURED, ACK])
def test_a_lost_report_is_requested_and_a_lost_answer_takes_no_second_picture(filmed, lost):
    b = filmed()
    deliver, dropped = b.filter, []

    async def mission(fc):
        camera = await present(b, fc)

        def without_first(link, packet):
            capture = int(dialect.MAV_CMD_IMAGE_START_CAPTURE).to_bytes(2, "little")
            if kind_of(packet) == lost and not dropped and (lost == CAPTURED or packet[10:12] == capture):
                dropped.append(packet)
            else:
                deliver(link, packet)

        b.filter = without_first
        await fc.execute("triggerCamera", [])
        assert (camera.pictures, len(dropped)) == (1, 1)

    b.run(mission)


@on_bench("filmed", faults=("loss=0.2",))
async def test_on_a_lossy_radio_each_command_takes_effect_once(b, fc, /):
    camera = await present(b, fc)
    for _ in range(3):
        await fc.execute("triggerCamera", [])
    await fc.execute("startVideo", [])
    await fc.execute("stopVideo", [])
    await fc.execute("startPictures", [1.0, 0])
    await fc.execute("stopPictures", [])
    assert 3 <= camera.pictures <= 8
    assert (camera.recording_since, camera.is_shooting) == (None, False)


@on_bench("bench", payload=Payload(frozenset()))
async def test_without_a_camera_it_is_an_error_that_says_what_is_missing(b, fc, /):
    for instruction, arguments in (("startPictures", [1.0, 0]), ("stopPictures", []), ("startVideo", [])):
        with pytest.raises(DeviceError, match=r"FAILED \(4\); no camera \(components 100 to 105"):
            await fc.execute(instruction, arguments)


@on_bench("filmed", options={"camera": 101})
async def test_the_camera_of_the_binding_is_named_when_it_is_missing(b, fc, /):
    await present(b, fc)
    with pytest.raises(DeviceError, match=r"no heartbeat of camera 101 of system 1; .* heartbeats: 100"):
        await fc.execute("triggerCamera", [])
    assert b.autopilot.payload.camera.pictures == 0


@on_bench("bench")
async def test_an_autopilot_takes_series_and_videos_without_reporting_them(b, fc, /):
    await fc.execute("startPictures", [1.0, 2])
    await b.until(lambda: b.autopilot.payload.camera.pictures == 2)
    await fc.execute("startVideo", [])
    assert b.autopilot.payload.camera.recording_since is not None
    await fc.execute("stopVideo", [])


@on_bench("filmed")
async def test_the_safe_state_does_not_end_a_recording(b, fc, /):
    camera = await present(b, fc)
    await fc.execute("startVideo", [])
    await fc.make_safe("land")
    assert camera.recording_since is not None


@pytest.mark.parametrize(
    ("interval", "count"), [(0.0, 1), (math.nan, 1), (math.inf, 0), (1.0, -1), (1.0, 70000)]
)
@on_bench("filmed")
async def test_a_series_that_makes_no_sense_is_refused_before_it_is_sent(b, fc, /, interval, count):
    sent = len(b.sent)
    with pytest.raises(DeviceError, match="startPictures requires"):
        await fc.execute("startPictures", [interval, count])
    assert len(b.sent) == sent
