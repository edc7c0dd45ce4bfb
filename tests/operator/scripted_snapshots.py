"""Snapshots of hosts for tests, in the form of messages and of the read model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from lfield.errors import LfieldError
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.team_state import HostState
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import EventBatch

K = TypeVar("K")


def batch_of(snapshot: Status) -> EventBatch:
    """The answer of a host to a request for its snapshot, after five events of its life."""
    return EventBatch(7, 1, 1.7e9, snapshot.up, 5, 5, [], {}, snapshot)


def states_of(answers: Mapping[K, Status | LfieldError]) -> dict[K, HostState]:
    """The hosts after these snapshots; an error for a host without an answer."""
    return host_states({k: batch_of(a) if isinstance(a, Status) else a for k, a in answers.items()})


def state_of(answer: Status | LfieldError) -> HostState:
    """One host."""
    return states_of({"": answer})[""]
