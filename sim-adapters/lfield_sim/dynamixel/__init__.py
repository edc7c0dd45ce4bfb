"""A fake chain of Dynamixel servos."""
