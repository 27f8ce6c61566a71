"""What a calibration found, and its file."""
