"""The one exception gtcal raises on purpose."""


class GtcalError(Exception):
    """A known failure, told in one line: what is wrong, in which file, camera, frame or field, what was
    expected, and what to do. The command line prints it as it is and exits with code 1."""
