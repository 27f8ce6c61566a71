"""How others calibrate: the methods to compare with, on the same recording and with the same result."""
