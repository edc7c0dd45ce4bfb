"""`gather` and `begin`: a `together` opens, and collects its calls while its body computes (decision 46)."""

from __future__ import annotations

from lfield.vm.agent import Agent
from lfield.vm.contract import Trap
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import FRAME, FRAME_SLOTS, TICKET, TICKET_WORDS
from lfield.vm.memory.tickets import new_ticket
from lfield.vm.scheduler import Scheduler


def gather(agent: Agent) -> int:
    """A new sentinel; raises Full."""
    return agent.block.allocate(TICKET, 0, TICKET_WORDS)


def collect(scheduler: Scheduler, agent: Agent, method: int, words: list[int]) -> None:
    """One more call; `words` are sentinel, array (or null) and index of its target, proxy, arguments.

    What the arguments lead to is copied now: what the block changes later does not reach the portal. Raises
    Full before the call is in, and Trap when the target is no element.
    """
    sentinel, array, index, proxy, *arguments = words
    block = agent.block
    if array and not 0 <= index < (block.w[array] >> 32) - 1:
        length = (block.w[array] >> 32) - 1
        raise Trap("IndexException", f"index {index} of an array of length {length}")
    call = block.allocate(FRAME, method, scheduler.layouts.frame_words[method])
    references = scheduler.reference_arguments(method)
    roots = [arguments[i - 1] for i in references]
    copies = deep_copy(block, roots, block, scheduler.layouts) if references else []
    w = block.w
    for i, word in enumerate(arguments, call + FRAME_SLOTS + 1):
        w[i] = word
    for i, place in zip(references, copies, strict=True):
        w[call + FRAME_SLOTS + i] = place
    new_ticket(block, sentinel, method, proxy, call, (array, index if array else 0))
