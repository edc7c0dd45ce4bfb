"""A Zenoh router for tests: `python router_process.py ENDPOINT [CONNECT...]`. It is part of the wheel."""

import json
import signal
import sys

import zenoh


def main() -> None:
    config = zenoh.Config()
    settings = {
        "mode": "router",
        "listen/endpoints": [sys.argv[1]],
        "connect/endpoints": sys.argv[2:],
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        print("ready", flush=True)
        signal.sigwait({signal.SIGTERM})


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    main()
