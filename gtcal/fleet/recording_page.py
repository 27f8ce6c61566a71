"""A recording's page where no report was written: all that the store has of its result, without the recording."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass

from jinja2 import Environment

from gtcal.fleet.history import Event
from gtcal.fleet.jobs import utc
from gtcal.fleet.measures import BOARD, RIG
from gtcal.fleet.record import Record

_WORDS = {
    "rmse_px": "RMSE, px",
    "rmse_mm": "RMSE, mm",
    "bias_x_px": "mean error along x, px",
    "bias_y_px": "mean error along y, px",
    "bias_radial_px": "mean error outwards, px",
    "bias_tangential_px": "mean error around, px",
    "moved_x_mm": "moved along x, mm",
    "moved_y_mm": "moved along y, mm",
    "moved_z_mm": "moved along z, mm",
    "turned_x_deg": "turned about x, deg",
    "turned_y_deg": "turned about y, deg",
    "turned_z_deg": "turned about z, deg",
    "focal_percent": "focal length, %",
    "sigma_px": "noise of a corner, px",
}
_COLUMNS = {RIG: "all", BOARD: "board"}


@dataclass(frozen=True)
class Row:
    """A quantity of the page's table, its values by column."""

    what: str
    cells: tuple[str, ...]


def recording_page(environment: Environment, event: Event, record: Record, kind: str, sign: str, rig_page: str) -> str:
    """The page's text. record: the event's, with its inputs. kind, sign: of its verdict. rig_page: where it leads back
    to."""
    columns = list(dict.fromkeys(what for what, _ in event.measures))
    return environment.get_template("recording.html.j2").render(
        event=event,
        record=record,
        kind=kind,
        sign=sign,
        rig_page=rig_page,
        taken=f"{utc(event.taken_ns):%Y-%m-%d %H:%M}",
        columns=[_COLUMNS.get(column, column) for column in columns],
        rows=list(_rows(event, columns)),
        options=json.dumps(record.options),
    )


def _rows(event: Event, columns: list[str]) -> Iterator[Row]:
    for quantity in dict.fromkeys(quantity for _, quantity in event.measures):
        values = (event.measures.get((column, quantity)) for column in columns)
        yield Row(_in_words(quantity), tuple("" if value is None else _shown(*value) for value in values))


def _in_words(quantity: str) -> str:
    if quantity.startswith("mocap_"):
        body, unit = quantity.removeprefix("mocap_").rsplit("_", 1)
        return f"noise of the mocap, {body}, {unit}"
    return _WORDS.get(quantity, quantity)


def _shown(value: float, sigma: float) -> str:
    """To the second digit of the sigma; to five digits where nobody knows one."""
    if not 0.0 < sigma < math.inf:
        return f"{value:.5g}"
    decimals = min(max(1 - math.floor(math.log10(sigma)), 0), 6)
    return f"{value:.{decimals}f} ± {sigma:.{decimals}f}"
