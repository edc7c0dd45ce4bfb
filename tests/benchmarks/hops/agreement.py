"""Messages for N resources to agree: a coordinator collects from each, then informs each (chapter IV).

N hosts run in one process on the in-memory network, which counts messages. The coordinator starts on the
last host and visits all hosts to collect and again to inform: every visit is one hop, 2N in total. In a
broadcast every host sends to every other host, N(N-1) messages, after which all hosts have all opinions but
no decision.

A hop is confirmed by a short message without waiting, as TCP confirms each message of a broadcast; the
table shows these too.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import COUNT
from harness.processes import Processes
from harness.samples import Contender
from hops.memory_team import carry_out

SIZES = (2, 4, 8, 16, 32, 64)

_PROGRAM = """
resource Voter {
    int wish;

    init(string[] arg) { wish = s2i(arg[1]); }

    portal opinion() emit int { return wish; }

    portal decide(int choice) { write(i2s(choice) + "\\n"); }
}

coordinator Vote {
    init(string[] arg) {
        Voter[] voters = findVoter();
        int choice = 0;
        for (int i = 0; i < voters.length(); i = i + 1) choice = max(choice, voters[i].opinion());
        for (int i = 0; i < voters.length(); i = i + 1) voters[i].decide(choice);
    }
}
"""


def counted(message: str) -> Opener:
    """Count one type of message: the migrations of the coordinator, or their confirmations."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        return lambda: {case: [agree(processes.folder(), count)[message]] for case, count in _CASES.items()}

    return opener


def broadcasting(checkout: Checkout, processes: Processes) -> Contender:
    """The messages of a broadcast from every host to every other host."""
    return lambda: {case: [count * (count - 1)] for case, count in _CASES.items()}


def agree(folder: Path, count: int) -> Counter[str]:
    """Let `count` resources, each on its own host, agree on the greatest wish; returns the sent messages."""
    voters = [f"//Voter:v{i}@h{i}?{7 * i % count}" for i in range(count)]
    sent, written = carry_out(folder, _PROGRAM, [*voters, f"//Vote:vote@h{count - 1}"])
    decisions = {int(text) for text in written}
    if decisions != {max(7 * i % count for i in range(count))}:
        raise RuntimeError(f"they decided on {decisions}")
    return sent


_CASES = {f"N = {count}": count for count in SIZES}

FIGURE = Figure(
    "Messages for N resources to agree, counted; ratio to a broadcast",
    {
        "lfield: hops": counted("Transfer"),
        "lfield: confirmations of hops": counted("TransferAccepted"),
        "broadcast: N(N-1) messages": broadcasting,
    },
    base=("broadcast: N(N-1) messages",),
    rounds=1,
    units=dict.fromkeys(_CASES, COUNT),
    sizes=_CASES,
    targets={"lfield: hops": "2N"},
)
