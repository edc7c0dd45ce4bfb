"""Motion commands: orders, trajectories, the setpoint stream, and speed control."""
