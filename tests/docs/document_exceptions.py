"""Lines of the documents that the tests do not run, each with the reason; and files that pages need.

A test fails if a line in this module is on no page.
"""

from __future__ import annotations

#: Reasons that several lines share.
SUITE = "runs these tests again, or tests that take hours"
HARDWARE = "hardware: a port or a bus of the robot"
INSTALLS = "installs software on the system"
WIREGUARD = "needs wireguard-tools, which the page installs; tried in two network namespaces"
NETWORK = "changes the network of the computer; tried in two network namespaces"
SIMULATOR = "needs the simulators of the autopilots: tests/sitl runs them if they are installed"
SERVICE = "needs systemd and a robot with lfield"
LONG = "takes minutes: "
RUNNING = "needs a running mission: "
INSPECT = RUNNING + "tests/cli/operations/test_ps_and_inspect.py"
QUERY = RUNNING + "tests/cli/operations/test_query.py"
TEAM = RUNNING + "tests/cli/operations"
WATCH = RUNNING + "tests/cli/watch/test_watch.py"
EXAMPLES = LONG + "tests/cli/run/test_thesis_and_examples.py runs it"
TUTORIAL = LONG + "tests/docs/test_getting_started.py runs it"
SURVIVES = LONG + "tests/cli/run/test_mission_survives.py runs it"
DRIVER = "needs a new driver: tests/cli/device/test_driver_new.py creates and runs one"
SETUP = "writes to a vehicle after a confirmation: tests/cli/device/test_setup_command.py"
GPS = "installs a driver: examples/20-gps-driver/tests runs its fake and its kit"
TIERS = "installs a driver: examples/16-three-tiers runs the mission, and its test_tutorial.py the lines"
FORMATION = LONG + "examples/20-formation/test_formation.py runs the mission in virtual time"
ARM = LONG + "examples/07-so101-arm/test_so101_arm.py runs it in virtual time"
SURVEY = LONG + "examples/08-survey/test_survey.py runs the mission in virtual time"
RESCUE = LONG + "examples/06-search-and-rescue/test_search_and_rescue.py runs it in virtual time"
ARENA = "installs a driver: 21-box-pushing, 22-predators and 23-soccer have their own tests"
KIT = "listens on a fixed port: tests/kits runs every kit with every fake"

#: By page: command lines, and first lines of outputs.
EXCEPTIONS: dict[str, dict[str, str]] = {
    "lfield/docs/networks.md": {
        "sudo apt-get install wireguard-tools wireguard-go": INSTALLS,
        "wg genkey > wg.key": WIREGUARD,
        "wg pubkey < wg.key > wg.pub": WIREGUARD,
        "sudo wireguard-go -f wg0": NETWORK,
        "sudo wg set wg0 private-key wg.key listen-port 51820": NETWORK,
        "sudo wg set wg0 peer ROBOT_PUB allowed-ips 10.50.0.2/32": NETWORK,
        "sudo ip addr add 10.50.0.1/24 dev wg0": NETWORK,
        "sudo ip link set wg0 up": NETWORK,
        "sudo wg set wg0 private-key wg.key": NETWORK,
        "sudo wg set wg0 peer SERVER_PUB allowed-ips 10.50.0.0/24 endpoint 192.0.2.1:51820": NETWORK,
        "sudo wg set wg0 peer SERVER_PUB persistent-keepalive 25": NETWORK,
        "sudo ip addr add 10.50.0.2/24 dev wg0": NETWORK,
        "ping -c 3 10.50.0.1": NETWORK,
        "sudo wg show wg0": NETWORK,
    },
    "tests/oracles/README.md": {
        ".venv/bin/pytest tests/oracles": SUITE,
        ".venv/bin/pytest -n 0 tests/oracles --every-case": SUITE,
        ".venv/bin/pytest -n 0 tests/oracles --every-case --rewrite": SUITE,
        "make oracles": SUITE,
    },
    "CONTRIBUTING.md": {
        "sudo apt-get install chromium chromium-driver": INSTALLS,
        "sudo apt-get install openssh-server sudo": INSTALLS,
        "make test": SUITE,
        "make test-more": SUITE,
        "make lint": SUITE,
        "python tests/benchmarks/hops/call_count.py": (
            "tests/benchmarks/test_call_count.py counts the same hops"
        ),
        ".venv/bin/pytest tests/vm/test_hop.py": SUITE,
        '.venv/bin/pytest -k "hostile" tests/vm': SUITE,
        "make bench ONLY=hop": SUITE,
        "make bench ONLY=radio ROUNDS=100": SUITE,
        "make fuzz COUNT=1000": SUITE,
        "make fuzz-decoders COUNT=10000": SUITE,
        "make oracles": SUITE,
        "make simulate SEEDS=10000": SUITE,
        "make chaos SECONDS=120": SUITE,
        "python tests/planted/catalogue.py --run": SUITE,
    },
    "README.md": {
        "lfield test examples/01-first-flight": (
            "examples/01-first-flight is part of this suite; lfield/docs/testing.md runs the command with -k"
        ),
        "sudo apt-get install python3 python3-venv make git": INSTALLS,
        "make demo": INSTALLS,
        "make test": SUITE,
        "bravo | link to alpha established": EXAMPLES,
        "lfield up mission.lfm --host alpha": HARDWARE,
        "lfield watch --deploy examples/01-first-flight/mission.dL": WATCH,
        "lfield up --deploy examples/03-mixed-team/mission.dL --all --sim --until-done": EXAMPLES,
    },
    "lfield/docs/getting-started.md": {
        "lfield up --deploy mission.dL --all --sim --until-done": TUTORIAL,
        "west | boss: row 0 done": TUTORIAL,
    },
    "lfield/docs/performance.md": {
        "make bench ONLY=hop": SUITE,
        "make bench ONLY=first": SUITE,
        "make bench ONLY=deaths": SUITE,
        "make bench ONLY=record": SUITE,
        "make bench ONLY=radio ROUNDS=100": SUITE,
        "make bench AGAINST=../older": SUITE,
    },
    "lfield/docs/watch.md": {
        "lfield watch --deploy mission.dL": WATCH,
        "lfield watch --replay DIR": "tests/replay/web runs it",
        "ssh -L 8470:127.0.0.1:8470 operator": SERVICE,
    },
    "lfield/docs/assistants.md": {
        "lfield keys person anna-assistant --may observe": "needs an authority: see security.md",
    },
    "lfield/docs/security.md": {
        "ssh alpha mkdir -p .config/lfield/keys": SERVICE,
        "scp -rp ~/.config/lfield/authority/hosts/alpha alpha:.config/lfield/keys/": SERVICE,
        "ssh alpha sudo cp -r .config/lfield/keys/alpha /etc/lfield/keys/": SERVICE,
        "ssh alpha sudo chown -R lfield: /etc/lfield/keys/alpha": SERVICE,
    },
    "deploy/README.md": {
        "lfield keys init --person anna": "creates keys of this user: tests/cli/development runs it",
        "lfield provision": "installs software on robots: tests/provision runs it",
        "lfield push deploy/two-copters/mission.dL --program examples/01-first-flight/mission.L": SERVICE,
        "lfield start": SERVICE,
        "lfield status": SERVICE,
        "lfield up mission.lfm --all --sim --until-done": EXAMPLES,
        **dict.fromkeys(
            (
                "sudo useradd --system --user-group --no-create-home --home-dir /var/lib/lfield "
                "--groups dialout lfield",
                'sudo usermod --append --groups lfield "$USER"',
                "sudo python3 -m venv --without-pip /opt/lfield/VERSION",
                "sudo /opt/lfield/VERSION/bin/python wheels/pip-VERSION.whl/pip install --no-index "
                "--find-links wheels --require-hashes -r run.txt",
                "sudo ln -sfn VERSION /opt/lfield/current",
                "sudo install -d -m 755 /etc/lfield/keys",
                "sudo install -d -m 700 -o lfield -g lfield /etc/lfield/keys/alpha",
                "sudo install -m 600 -o lfield -g lfield -t /etc/lfield/keys/alpha "
                "keys/host.key keys/host.pem keys/authority.pem keys/revoked.crl",
                "sudo cp inventory.yaml /etc/lfield/",
                "echo LFIELD_HOST=alpha | sudo tee /etc/lfield/service.env",
                "sudo cp lfield.service /etc/systemd/system/",
                "sudo systemctl daemon-reload",
                "sudo systemctl enable --now lfield",
                "sudo -u lfield /opt/lfield/current/bin/lfield doctor",
            ),
            INSTALLS,
        ),
    },
    "drivers/lfield_can/README.md": {
        "sudo ip link set can0 up type can bitrate 500000 restart-ms 100": HARDWARE,
    },
    "examples/01-first-flight/README.md": {
        "lfield up --deploy examples/01-first-flight/mission.dL --all --sim --until-done": EXAMPLES,
        "alpha | lead: taking off to 2.0 m": EXAMPLES,
        "bravo | pilot: smallest measured distance 7.3 m; batteries lead 97 %, wing 97 %": EXAMPLES,
        "lfield ps --deploy examples/01-first-flight/mission.dL": INSPECT,
        "$ lfield ps --deploy examples/01-first-flight/mission.dL": INSPECT,
    },
    "examples/02-equivalent-lift/README.md": {
        "python examples/02-equivalent-lift/demo.py": f"{LONG}tests/cli/run/test_equivalent_lift.py",
        "Run 1: everything works": f"{LONG}tests/cli/run/test_equivalent_lift.py",
    },
    "examples/04-the-mission-survives/README.md": {
        "python examples/04-the-mission-survives/run.py": SURVIVES,
        "self: hosts that are started again": SURVIVES,
        "quorum: a host that never comes back": SURVIVES,
    },
    "examples/03-mixed-team/README.md": {
        "lfield up --deploy examples/03-mixed-team/mission.dL --all --sim --until-done": EXAMPLES,
        "sky   | carrier.fc device watchdog: 2 s, limit 1 s; accepted by a waiver": EXAMPLES,
    },
    "examples/05-two-carry-one/README.md": {
        "lfield up --deploy examples/05-two-carry-one/mission.dL --all --sim --until-done": EXAMPLES,
        "lfield test examples/05-two-carry-one": SUITE,
        "bravo | beam: ada+bob take the beam (composed: two-carry-one of Haul (ada), Haul (bob))": EXAMPLES,
    },
    "examples/07-so101-arm/README.md": {
        "lfield up --deploy examples/07-so101-arm/dynamixel.dL --all --sim --until-done": ARM,
        "lfield test examples/07-so101-arm": SUITE,
    },
    "examples/08-survey/README.md": {
        "lfield up --deploy examples/08-survey/mission.dL --all --sim --until-done": SURVEY,
        "lfield watch --deploy examples/08-survey/mission.dL": SURVEY,
        "lfield test examples/08-survey": SUITE,
    },
    "examples/06-search-and-rescue/README.md": {
        "lfield up --deploy examples/06-search-and-rescue/mission.dL --all --sim --until-done": RESCUE,
        "lfield test examples/06-search-and-rescue": SUITE,
        "copter3 | rescue: strip 2 is searched": RESCUE,
    },
    "examples/16-three-tiers/README.md": {
        "pip install -e examples/16-three-tiers/planner": TIERS,
        "lfield up --deploy examples/16-three-tiers/mission.dL --all --sim --until-done": TIERS,
        "tower  | sequencer: copter can go 105 m, and shall visit gate yard": TIERS,
        "lfield driver new router --sensor --into router": TIERS,
        'echo \'{"sites": [[10, 0], [0, 10]], "worth": [1, 1], "start": [0, 0], "reach": 40}\' '
        "| python -m lfield_planner.worker": TIERS,
        '{"tour": [0, 1]}': TIERS,
        "lfield sim planner --listen tcp:127.0.0.1:5598 --fault nonsense=repeated &": TIERS,
        "lfield sim fault planner slow=1e6": TIERS,
        "lfield kit planner --endpoint process:": TIERS,
    },
    "examples/15-tuple-space/README.md": {"lfield test examples/15-tuple-space": SUITE},
    "examples/20-formation/README.md": {
        "lfield up --deploy examples/20-formation/mission.dL --all --sim --until-done": FORMATION,
        "lfield test examples/20-formation": SUITE,
        "python examples/20-formation/terrain_marches.py": FORMATION,
        "carol | march: the march is over; the coordinator migrated 100 times": FORMATION,
    },
    "examples/20-gps-driver/README.md": {
        "pip install -e examples/20-gps-driver": GPS,
        "lfield sim gps &": GPS,
        "lfield kit gps --endpoint serial:/dev/ttyUSB0:9600": GPS,
        "lfield up --deploy examples/20-gps-driver/mission.dL --all --sim --until-done": GPS,
        "lfield test examples/20-gps-driver": GPS,
        "afloat | surveyor: 40.0 m over 21 places": GPS,
    },
    "examples/21-box-pushing/README.md": {
        "pip install -e examples/21-box-pushing": ARENA,
        "lfield up --deploy examples/21-box-pushing/mission.dL --all --sim --until-done": ARENA,
        "lfield test examples/21-box-pushing": ARENA,
        "python examples/21-box-pushing/terrain_pushes.py": ARENA,
        "centre    | movers: the box is at (2.99, 1.00), heading 0.50 after 24 steps and 101 hops": ARENA,
    },
    "examples/22-predators/README.md": {
        "pip install -e examples/21-box-pushing": ARENA,
        "lfield up --deploy examples/22-predators/mission.dL --all --sim --until-done": ARENA,
        "lfield test examples/22-predators": ARENA,
        "python examples/22-predators/hunt_statistics.py": ARENA,
        "west  | hunt: caught by 4 at (4.0, 0.1) after 18 steps and 111 hops": ARENA,
    },
    "examples/23-soccer/README.md": {
        "pip install -e examples/21-box-pushing": ARENA,
        "lfield up --deploy examples/23-soccer/mission.dL --all --sim --until-done": ARENA,
        "lfield test examples/23-soccer": ARENA,
        "lfield up --deploy examples/23-soccer/red.dL --all --sim --until-done &": ARENA,
        "lfield up --deploy examples/23-soccer/blue.dL --all --sim --until-done": ARENA,
        "python examples/23-soccer/league.py": ARENA,
    },
    "drivers/lfield_mavlink/README.md": {
        "lfield setup --deploy mission.dL": SETUP,
        "lfield setup mavlink --endpoint udp:127.0.0.1:14550 --set ttl=1.0 --set 'limits={speed: 5}'": SETUP,
        "lfield setup --apply FILE": SETUP,
    },
    "lfield/docs/driver-authors.md": {
        "lfield driver new lamp && cd lfield_lamp && pip install -e .": DRIVER,
        "lfield sim lamp --listen tcp:127.0.0.1:5599 &": DRIVER,
        "lfield kit lamp --endpoint tcp:127.0.0.1:5599 --yes": DRIVER,
    },
    "lfield/docs/operations.md": {
        "'silence: 0.1' is too short for this computer: heartbeats to guards are up to 0.12 s late, "
        "and the shortest possible silence is 0.3 s: "
        "reduce the load of "
        "this computer, give its guards": "needs a slow computer: tests/devices/test_jitter_measurement.py",
        'lfield estop --reason "person on the field"': TEAM,
        "lfield estop mission.lfm": TEAM,
        "stopping tour-0a1b2c3d: alpha, bravo": TEAM,
        "lfield query Lift --deploy mission.dL --at air --json": QUERY,
        "from the running team: 4 of 4 hosts answered": QUERY,
        "HOST    AGENT   TYPE    STATE                                HOPS  SERVED   HEAP": TEAM,
        "lfield inspect dumps/survey.block": INSPECT,
        "$ lfield inspect dumps/survey.block": INSPECT,
    },
    "sim-adapters/REAL.md": {
        "make test-sitl ARDUCOPTER=~/ardupilot/build/sitl/bin/arducopter "
        "PX4=~/PX4-Autopilot/build/px4_sitl_default/bin/px4": SIMULATOR,
        "arducopter --model + --speedup 1 --serial0 tcp:0 --defaults "
        "sim-adapters/real/arducopter.parm": SIMULATOR,
        "arducopter --model + --speedup 1 --serial0 tcp:0 --defaults sim-adapters/real/arducopter.parm "
        "--instance 1 --sysid 2": SIMULATOR,
        "ardurover --model rover --speedup 1 --serial0 tcp:0 --defaults "
        "sim-adapters/real/ardurover.parm": SIMULATOR,
        "PX4_SIM_MODEL=sihsim_quadx px4 -i 0 -d -w /tmp/px4-0 build/px4_sitl_default/etc": SIMULATOR,
        "PX4_SIM_MODEL=sihsim_quadx px4 -i 1 -d -w /tmp/px4-1 build/px4_sitl_default/etc": SIMULATOR,
        "lfield setup --deploy examples/01-first-flight/mission.dL "
        "--devices sim-adapters/real/arducopter/01-first-flight.devices.yaml": SIMULATOR,
        "lfield up --deploy examples/01-first-flight/mission.dL "
        "--devices sim-adapters/real/arducopter/01-first-flight.devices.yaml --all --until-done": SIMULATOR,
        "lfield kit mavlink --endpoint tcp:127.0.0.1:5760 --set 'waivers=[device_watchdog]' "
        "--set 'limits={speed: 5}'": SIMULATOR,
        "lfield sim can --listen socketcand:127.0.0.1:29536 --device cia402:5,counts=10000": KIT,
        "lfield sim dynamixel --servo 1:XM540-W270 --servo 2:XM540-W270 --listen /tmp/lfield-arm": KIT,
        "lfield sim dynamixel --servo 1:XM430-W350 --listen /tmp/lfield-hand --fault obstacle=-0.1": KIT,
    },
    "lfield/driver/skeleton/README.md.in": {
        "pip install -e .": DRIVER,
        "lfield sim $name --listen $listen &": DRIVER,
        "lfield kit $name --endpoint $address --yes": DRIVER,
        "lfield sim fault $name silent=true": DRIVER,
        "pytest": DRIVER,
    },
    "lfield/driver/skeleton/sensor/README.md.in": {
        "pip install -e .": DRIVER,
        "lfield sim $name --listen $listen &": DRIVER,
        "lfield kit $name --endpoint $address": DRIVER,
        "lfield sim fault $name silent=true": DRIVER,
        "pytest": DRIVER,
    },
}

#: By page: files of the page, each with the file of the repository that has its content.
FILES: dict[str, dict[str, str]] = {
    "lfield/docs/operations.md": {
        "mission.L": "examples/02-equivalent-lift/mission.L",
        "mission.dL": "examples/02-equivalent-lift/mission.dL",
        "mission.capabilities.yaml": "examples/02-equivalent-lift/mission.capabilities.yaml",
    },
    "lfield/docs/mission-files.md": {
        "north-field.plan": "tests/mavlink/files/north-field.plan",
        "north.kml": "tests/mavlink/files/north.kml",
    },
    "drivers/lfield_can/README.md": {"gripper.dbc": "sim-adapters/lfield_sim/can/gripper.dbc"},
    "drivers/lfield_mavlink/README.md": {"keys/alpha.key": "LICENSE"},
}
