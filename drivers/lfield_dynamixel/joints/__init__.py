"""How servos are mounted: names, directions, zeros and bounds of joints, and calibration files."""
