"""The result of a query or an order, as the page reads it."""

from __future__ import annotations

import json

from lfield.capability.model import Primitive
from lfield.capability.offer import Fact, Offer, Rejection
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.operator.dashboard.operator_actions import OrderOutcome, QueryAnswer
from lfield.operator.team_query import PrimitiveAnswer
from lfield.operator.web.answer_json import order_json, query_json


def test_offers_have_units_and_refusals_their_reasons():
    arm = Offer("Grip", "direct", "grip", "arm1", "alpha", 1.0, {"payload": Fact(2.5)})
    copter = Offer(
        "Lift", "direct", "lift", "lead", "bravo", 0.25, {"payload": Fact(0.5), "tools": Fact("winch")}
    )
    both = Offer(
        "Lift", "composed", "w", "arm1+lead", "alpha+bravo", 3.0, {}, {"w_grip": arm}, "grip-and-climb"
    )
    refused = Rejection("rover", ("payload 0.2 < 2.0",))
    found = PrimitiveAnswer(primitive(), (copter, both), 2, (refused,), ("only the best",))
    answer = QueryAnswer("Lift", (found,), {"charlie": "no program listens"}, units={"payload": "kg"})
    decoded = json.loads(query_json(answer))
    (lift,) = decoded["answers"]
    first, second = lift["offers"]
    assert first["facts"] == ["payload 0.5 kg", "tools winch"]
    assert (first["how"], first["score"]) == ("direct", 0.8)
    assert second["how"] == "by grip-and-climb"
    assert (first["hosts"], second["hosts"]) == (["bravo"], ["alpha"])
    assert second["parts"] == ["arm1 at alpha: Grip"]
    assert lift["refusals"] == "rover: payload 0.2 < 2.0"
    assert decoded["unreachable"] == {"charlie": "no program listens"}


def primitive() -> Primitive:
    return read_registry().primitives["Lift"]


def test_an_order_result_reports_full_success():
    assert json.loads(order_json(OrderOutcome("stop", ("lead.fc",))))["is_complete"] is True
    decoded = json.loads(
        order_json(OrderOutcome("stop", ("lead.fc",), {"wing.fc": "no answer"}, {"charlie": "gone"}))
    )
    assert (decoded["is_complete"], decoded["confirmed"], decoded["unreached"]) == (
        False,
        ["lead.fc"],
        {"charlie": "gone"},
    )
