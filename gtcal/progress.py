"""How long work reports progress: a callable handed in, so that the core prints nothing."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called as ``progress(what, done, total)``: ``what`` names the work in a few words, ``done`` counts up to
``total``. It must be cheap and must not raise."""


def silent(what: str, done: int, total: int) -> None:
    """The default: report to nobody."""
