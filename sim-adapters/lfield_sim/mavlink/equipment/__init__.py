"""Equipment on the wire: commands of the autopilot, gimbal manager, camera and gimbal components."""
