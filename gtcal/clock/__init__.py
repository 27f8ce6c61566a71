"""The offset between the cameras' clock and the mocap's: found, tested, and how sure it is."""
