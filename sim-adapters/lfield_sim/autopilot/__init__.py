"""A vehicle with its autopilot, without a wire: pure, stepped by time. From the bottom:

`vehicle` moves (kinematics) in the `wind`, `equipment` is what it carries, `plans` what was uploaded to it;
`flavours` says what tells autopilots apart, `ardupilot` and `px4` are that as data: modes, parameters,
failsafes, texts. `pilot` holds the state and enters modes; `flight` and `missions` do what a mode does
as time passes; `watch` looks out; `autopilot` takes commands and lets time pass.
"""
