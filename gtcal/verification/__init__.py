"""A second, independent recording tells whether a calibration is true."""
