"""Presses stop again and again, from a command or on the page of `lfield watch`, and prints how long it took.

    radio_desk.py command PAUSE MISSION OPTION...       what `lfield estop` does, without the start of Python
    radio_desk.py page PAUSE LINK                       the button of the page at that link

Prints `stopping`, then `stop = SECONDS` when every device has confirmed, `lifting` and `lifted`. What was not
confirmed is pressed again, as part of the same stop, and a line `again: ...` says why.
"""

from __future__ import annotations

import contextlib
import http.client
import io
import json
import sys
import time
from collections.abc import Callable, Sequence
from urllib.parse import urlsplit

from lfield.cli.main import main as lfield

#: Seconds that whatever belongs to the one order has before the next one.
SETTLE = 0.1
#: Gives an order, `stop` or `lift`; returns why it was not carried out, or "".
Press = Callable[[str], str]


def command(words: Sequence[str]) -> Press:
    """`lfield estop`, in this process."""

    def press(order: str) -> str:
        said = io.StringIO()
        option = "--lift" if order == "lift" else "--no-wait"
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            status = lfield(["estop", *words, option])
        return f"status {status}: {said.getvalue()}" if status else ""

    return press


def page(link: str) -> Press:
    """The request that a browser sends when a person presses a button."""
    address = urlsplit(link)
    connection = http.client.HTTPConnection(address.netloc, timeout=60)
    connection.request("GET", f"{address.path}?{address.query}")
    answer = connection.getresponse()
    answer.read()
    headers = {
        "Cookie": (answer.getheader("Set-Cookie") or "").partition(";")[0],
        "Origin": f"{address.scheme}://{address.netloc}",
        "Content-Type": "application/json",
    }

    def press(order: str) -> str:
        said = json.dumps({"action": order, "pressed": time.monotonic()})
        connection.request("POST", "/act", said, headers)
        answered = connection.getresponse()
        text = answered.read().decode()
        return "" if answered.status == 200 and json.loads(text)["well"] else f"{answered.status}: {text}"

    return press


def persistently(press: Press, order: str) -> float:
    """Seconds until it was carried out."""
    start = time.monotonic()
    while why := press(order):
        print("again:", " ".join(why.split()), flush=True)
    return time.monotonic() - start


def run(press: Press, pause: float) -> None:
    """Stop and lift for ever."""
    while True:
        print("lifting", flush=True)
        time.sleep(SETTLE)
        persistently(press, "lift")
        print("lifted", flush=True)
        time.sleep(pause)
        print("stopping", flush=True)
        time.sleep(SETTLE)
        print(f"stop = {persistently(press, 'stop'):.6f}", flush=True)
        time.sleep(SETTLE)


if __name__ == "__main__":
    way, seconds, *words = sys.argv[1:]
    run(command(words) if way == "command" else page(words[0]), float(seconds))
