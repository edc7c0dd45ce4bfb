"""`python -m lfield_sim mavlink --listen udp:127.0.0.1:14550`: runs a simulated device by its name."""

from __future__ import annotations

import sys

from lfield.driver.sims import main

FAKES = {name: f"lfield_sim.{name}:SIM" for name in ("can", "dynamixel", "mavlink")}

if __name__ == "__main__":
    names = sys.argv[1:2]
    if not names or names[0] not in FAKES:
        print(f"usage: python -m lfield_sim {'|'.join(FAKES)} [options]", file=sys.stderr)
        sys.exit(64)
    sys.exit(main([FAKES[names[0]], *sys.argv[2:]]))
