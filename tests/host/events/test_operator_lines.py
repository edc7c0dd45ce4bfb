"""Lines of input from an observer: a waiting agent gets them, and observers see which agent waits."""

from __future__ import annotations

from lfield.host.inputs import LineEntered
from lfield.operator.client import SNAPSHOT
from lfield.operator.observer_link import input_line, send_request
from lfield.text import log_messages
from lfield.vm.waits.operator_input import MAX_LINE, NO_READER
from lfield.wire.events import InputAwaited, LineLogged
from lfield.wire.observer_messages import InputResult
from lfield.wire.subscription_messages import EventBatch

PROGRAM = """
resource Desk {
    init(string[] arg) { }
    portal ask(real limit) emit string { return read(limit); }
}
coordinator Asker {
    init(string[] arg) {
        print(findDesk("desk").ask(20.0));
        try { findDesk("desk").ask(1.0); }
        catch (TimeLimitException e) { print(e.source()); }
    }
}
"""
DEPLOYMENT = "//Asker:asker@home\n//Desk:desk@home\n"


async def test_a_line_from_an_observer_goes_to_the_waiting_agent(team, /):
    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT))
    desk = team.network.transport("desk")
    await team.until(lambda: home.host.machine.operator_input.waiting_agents)
    assert (await _snapshot(desk)).snapshot.reads == ["desk"]
    refused = await send_request(desk, "home:8181", input_line("asker", "yes"))
    assert refused == InputResult(NO_READER.format(agent="asker"))
    assert await send_request(desk, "home:8181", input_line("desk", "yes")) == InputResult()
    await team.until(lambda: "asker: yes" in home.log)
    assert await team.ended("asker") == "done"
    assert (await _snapshot(desk)).snapshot.reads == []
    refused = await send_request(desk, "home:8181", input_line("desk", "late"))
    assert refused == InputResult(NO_READER.format(agent="desk"))
    whats = [event.what for event in home.host.recorder.event_log.after(0, 1000, 1 << 20)[0]]
    assert [what.agents for what in whats if isinstance(what, InputAwaited)] == ["desk", "", "desk", ""]
    codes = [what.code for what in whats if isinstance(what, LineLogged)]
    assert [code for code in codes if code.startswith("input-")] == [
        line.code
        for line in (
            log_messages.INPUT_AWAITED,
            log_messages.INPUT_RECEIVED,
            log_messages.INPUT_DROPPED,
            log_messages.INPUT_RECEIVED,
            log_messages.INPUT_READ,
            log_messages.INPUT_AWAITED,
            log_messages.INPUT_RECEIVED,
            log_messages.INPUT_DROPPED,
        )
    ]


async def test_a_long_line_of_a_terminal_is_shortened_and_reported(team, /):
    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT))
    await team.until(lambda: home.host.machine.operator_input.waiting_agents)
    home.host.dispatch(LineEntered("x" * MAX_LINE + "y"))
    await team.until(lambda: f"asker: {'x' * MAX_LINE}" in home.log)
    assert str(log_messages.INPUT_CUT.line(host="home", length=MAX_LINE)) in home.log


async def _snapshot(transport) -> EventBatch:
    return await send_request(transport, "home:8181", SNAPSHOT)
