"""The mounting of servos: names, directions, zeros and bounds of joints, and calibration files."""
