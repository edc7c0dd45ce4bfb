"""Stops a team repeatedly, by a command or the page of `lfield watch`, and prints the seconds of each stop.

radio_desk.py command PAUSE MISSION OPTION...       like `lfield estop`, without the start of Python
radio_desk.py page PAUSE LINK                       the button of the page at that link

Prints `stopping`, then `stop = SECONDS` when every device has confirmed, `lifting` and `lifted`. An
unconfirmed order is repeated as part of the same stop; a line `again: ...` has the reason.
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

#: Seconds for the traffic of an order before the next one.
SETTLE = 0.1
#: Sends an order, `stop` or `lift`; returns the reason of a failure, or "".
Press = Callable[[str], str]


def command(words: Sequence[str]) -> Press:
    """Orders by `lfield estop` in this process."""

    def press(order: str) -> str:
        output = io.StringIO()
        option = "--lift" if order == "lift" else "--no-wait"
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            status = lfield(["estop", *words, option])
        return f"status {status}: {output.getvalue()}" if status else ""

    return press


def page(link: str) -> Press:
    """Orders by the requests that a browser sends for a button."""
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
        body = json.dumps({"action": order, "pressed": time.monotonic()})
        connection.request("POST", "/order", body, headers)
        answered = connection.getresponse()
        text = answered.read().decode()
        return "" if answered.status == 200 and json.loads(text)["well"] else f"{answered.status}: {text}"

    return press


def repeat_until_done(press: Press, order: str) -> float:
    """Repeat an order until it is carried out; returns the seconds."""
    start = time.monotonic()
    while reason := press(order):
        print("again:", " ".join(reason.split()), flush=True)
    return time.monotonic() - start


def run(press: Press, pause: float) -> None:
    """Stop and lift until killed."""
    while True:
        print("lifting", flush=True)
        time.sleep(SETTLE)
        repeat_until_done(press, "lift")
        print("lifted", flush=True)
        time.sleep(pause)
        print("stopping", flush=True)
        time.sleep(SETTLE)
        print(f"stop = {repeat_until_done(press, 'stop'):.6f}", flush=True)
        time.sleep(SETTLE)


if __name__ == "__main__":
    way, seconds, *words = sys.argv[1:]
    run(command(words) if way == "command" else page(words[0]), float(seconds))
