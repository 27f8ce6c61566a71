"""How sure a calibration is, shown where it matters: in words, in px over an image, in mm over the capture volume."""
