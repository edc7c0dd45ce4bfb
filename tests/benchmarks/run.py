"""The figures of lfield, by name: `make bench`, `make bench ONLY=hop,local`."""

from __future__ import annotations

import sys
from pathlib import Path

from harness.bench import main
from harness.picture import Pictured

# The emulated radio, the network in memory and the world of stops in virtual time are tools of the tests.
sys.path += [
    str(Path(__file__).parents[1] / folder)
    for folder in ("radio", "net/memory", "host/orders", "operator/orders", "editor")
]

FIGURES = {
    "hop": "hops.hop",
    "stages": "hops.stages",
    "tls": "hops.secrecy",
    "local": "hops.local",
    "agreement": "hops.agreement",
    "together": "hops.together",
    "race": "hops.first_of",
    "journal": "hops.journal",
    "engine": "machine.engine",
    "collections": "machine.collection_speed",
    "collector": "machine.collector",
    "start": "machine.start",
    "first": "machine.first_second",
    "memory": "machine.memory",
    "compiler": "machine.compiler",
    "compile": "machine.compile",
    "mavlink": "guards.mavlink",
    "can": "guards.can_load",
    "deaths": "deaths.deaths",
    "query": "capability.query",
    "rankings": "capability.rankings",
    "traffic": "team.traffic",
    "hosts": "team.host_processes",
    "events": "team.events",
    "strangers": "team.strangers",
    "leases": "team.leases",
    "recovery": "team.recovery",
    "missions": "team.tested_missions",
    "watch": "page.watched",
    "exports": "page.exports",
    "lsp": "page.language_server",
    "radio": "radio.poor_radio",
    "zenoh": "radio.zenoh_hops",
    "push": "radio.pushes",
    "record": "recorder.recorded",
}

#: What the picture of the README shows, in this order.
PICTURED = {
    "hop": Pictured("A remote portal call", "bytes of live state"),
    "rankings": Pictured("A find in a team whose values change", "agents", "lively"),
    "compiler": Pictured("From L to a program, processor time", "lines"),
    "collector": Pictured("Pause of the collector", "bytes alive"),
    "agreement": Pictured("Messages until all agree", "resources"),
    "together": Pictured("All work for 0.1 s", "resources", cost="seconds"),
}

if __name__ == "__main__":
    sys.exit(main(FIGURES, sys.argv[1:], pictured=PICTURED))
