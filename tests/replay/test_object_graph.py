"""Containers that a core creates while it runs, in a checkpoint and restored."""

from __future__ import annotations

from collections import Counter, OrderedDict, defaultdict, deque

import pytest

from lfield.errors import RecordingError
from lfield.host.recording.object_graph import GraphReader, GraphWriter


def restored(value):
    writer = GraphWriter({}, lambda reading: -1)
    reference = writer.encode(value)
    reader = GraphReader(lambda reference: None, [], None)
    reader.create(writer.objects())
    return reader.decode(reference)


@pytest.mark.parametrize(
    "value",
    [
        {"a": 1, "b": [2.0]},
        OrderedDict([("b", 1), ("a", 2)]),
        Counter({"came": 3}),
        [1, (2, "x")],
        {1, 2},
        deque([1, 2]),
        defaultdict(list, {"a": [1]}),
    ],
)
def test_a_container_keeps_its_kind(value):
    found = restored(value)
    assert type(found) is type(value)
    assert found == value
    assert getattr(found, "default_factory", None) is getattr(value, "default_factory", None)


@pytest.mark.parametrize("value", [deque([1], maxlen=3), defaultdict(int), type("Own", (dict,), {})()])
def test_a_container_that_could_not_be_made_again_is_refused(value):
    writer = GraphWriter({}, lambda reading: -1)
    writer.encode(value)
    with pytest.raises(RecordingError):
        writer.objects()
