"""What is done with heaps is compared with Python here, function by function: no machine runs on two engines."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def engine() -> None:
    """Instead of the engines that the other tests of the machine run on."""
