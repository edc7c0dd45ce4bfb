"""Equipment of a vehicle: battery, outputs, winch, gimbal and camera, as models without messages."""
