"""Text from outside (names, paths, words of files) where it is shown: nothing in it acts, whatever shows it."""

from __future__ import annotations

import logging
import re

_ACTING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")  # all control characters but \t and \n
_NO_XML = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
_SEPARATES_CELLS = re.compile(r"[,;|\s\"]")
_RUN_BY_SPREADSHEETS = ("=", "+", "-", "@", "\t", "\r")


def printable(text: str) -> str:
    """The text with its control characters, line ends and tabs aside, as \\x1b: a terminal and a page show them and do
    nothing."""
    return _ACTING.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def one_line(text: str) -> str:
    """``printable`` in a single line."""
    return printable(text).replace("\n", "\\n")


def xml_text(content: bytes) -> bytes:
    """XML without the characters that no XML may hold, a question mark for each."""
    return _NO_XML.sub(b"?", content)


def csv_cell(text: str) -> str:
    """A cell of a CSV that no spreadsheet takes for a formula, nor for several cells, be its separator a comma, a
    semicolon or a tab."""
    shown = f"'{text}" if text.lstrip().startswith(_RUN_BY_SPREADSHEETS) else text
    return '"' + shown.replace('"', '""') + '"' if _SEPARATES_CELLS.search(shown) else shown


class OneLine(logging.Formatter):
    """A warning in one line, whatever is in it."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return one_line(super().formatMessage(record))
