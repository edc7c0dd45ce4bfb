"""Payload of a vehicle: gripper, winch, servos, relays, gimbal, camera."""
