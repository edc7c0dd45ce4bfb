"""A CiA 402 drive after its start."""

from __future__ import annotations

import pytest
from can_fake_bench import DriveBench


@pytest.fixture
def bench() -> DriveBench:
    bench = DriveBench()
    bench.wait(0.1)
    return bench
