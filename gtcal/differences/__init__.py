"""Two calibrations of one rig: what moved, what is the same, and what they can't tell apart."""
