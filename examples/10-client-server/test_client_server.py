"""Client and server, on virtual time: `lfield test examples/10-client-server`."""

from __future__ import annotations

import re

from lfield.testing import LObject


def _running_totals(lines, rover):
    amounts = [int(line.split()[2]) for line in lines if line.startswith(rover)]
    return [sum(amounts[: n + 1]) for n in range(len(amounts))]


def test_each_rover_gets_its_order_from_the_fullest_shelf(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    lines = {
        host: [line.text for line in team.log if line.host == host] for host in ("yard", "north", "south")
    }
    yard = [line for line in lines["yard"] if " takes " in line]
    for host, rover in (("north", "red"), ("south", "blue")):
        delivered = [line for line in lines[host] if "has delivered" in line]
        assert delivered == [f"{rover} has delivered {n}" for n in _running_totals(yard, rover)]
    matches = [re.fullmatch(r"(red|blue) takes (\d+) from shelf ([012])", line) for line in yard]
    assert [m[1] for m in matches].count("red") == 3
    assert [m[1] for m in matches].count("blue") == 2
    stock = [7, 12, 5]
    for match in matches:
        assert stock[int(match[3])] == max(stock), "the depot must use the fullest shelf"
        stock[int(match[3])] -= int(match[2])
    assert min(stock) >= 0


def test_couriers_deliver_the_orders_of_a_double_of_the_depot(lfield_mission):
    class Depot:
        def __init__(self):
            self.requests = []

        def take(self, rover, amount):
            self.requests.append((rover, amount))
            return LObject("Order", shelf=1, amount=amount)

    depot = Depot()
    team = lfield_mission("mission.dL", doubles={"depot": depot})
    team.run(until_done=True)
    assert sorted({rover for rover, _ in depot.requests}) == ["blue", "red"]
    orders = [call.arguments[0] for call in team.calls if call.portal == "deliver"]
    assert all(order.shelf == 1 for order in orders)
    assert sum(order.amount for order in orders) == sum(amount for _, amount in depot.requests)
