"""A vehicle with its autopilot, without a wire: pure, stepped by time. Bottom-up:

`vehicle` (kinematics) in the `wind`, `equipment`, uploaded `plans`; `flavours` describes differences of
autopilots, `stacks` has them as data: modes, parameters, failsafes, texts. `pilot` has the state and enters
modes; `flight_modes` and `mission_flight` implement modes over time; `monitoring` watches; `autopilot`
handles commands.
"""
