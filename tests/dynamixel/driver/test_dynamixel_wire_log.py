"""The wire log of a servo bus: times and bytes in hexadecimal."""

from __future__ import annotations

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call
from hex_log import parse_hex_line

from lfield.driver.recording.wire_formats import HEX_HEADER
from lfield.recording.ring_writer import RingWriter


@on_bench(Bench)
async def test_requests_and_answers_are_logged(bench, joint, /, tmp_path):
    bench.sent.clear()
    bench.driver.wire_log.start(
        lambda suffix, header: RingWriter(tmp_path, "wire-a", suffix, 1 << 20, pytest.fail, header)
    )
    await call(joint, "torque", True)
    await call(joint, "moveTo", 0.1)
    bench.driver.wire_log.close()
    sent = [data for _, data in bench.sent]
    (path,) = tmp_path.iterdir()
    assert path.name == "wire-a-000001.hex.log"
    assert path.stat().st_mode & 0o777 == 0o600
    header, *lines = path.read_text().splitlines(keepends=True)
    assert header.encode() == HEX_HEADER
    found = [parse_hex_line(line) for line in lines]
    assert [data for _, is_sent, data in found if is_sent] == sent
    answers = [data for _, is_sent, data in found if not is_sent]
    assert answers
    assert all(data.startswith(b"\xff\xff\xfd\x00\x01") for data in answers)
    assert [time for time, _, _ in found] == sorted(time for time, _, _ in found)
