"""What every result shows of itself, at a prompt and in a notebook."""

from __future__ import annotations

import json
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

_PRESENTATION = "gtcal.presentation"  # floors above, with tables and figures: loaded when something is shown


class Presented:
    """Prints as the command line's tables; in a notebook as the report's page. Of a dataclass with repr=False."""

    def __repr__(self) -> str:
        return str(_asked("text", self))

    def _repr_html_(self) -> str:
        return str(_asked("html", self))

    def to_dict(self) -> dict[str, Any]:
        """As it stands in its JSON file: plain lists, numbers and text; None for what is no number."""
        return dict(json.loads(json.dumps(_asked("document", self), allow_nan=False)))

    def to_pandas(self) -> pandas.DataFrame:
        """A row for each camera (of a difference for each change, of a series for each recording and camera, of a
        diagnosis for each finding, of a comparison for each method), units in the columns' names.

        Raises GtcalError where pandas is not installed."""
        return _asked("frame", self)


class PresentedCalibration(Presented):
    """The figures of a calibration, in the report's style."""

    def plot_cameras(self) -> Figure:
        """Where the cameras are in ref and look to, from two sides, and how well each fits."""
        return _asked("cameras_figure", self)

    def plot_residuals(self, camera: str) -> Figure:
        """Mean residual over the image of a camera, by bin: arrows that agree with their neighbours are lens or chain,
        not noise.

        Raises GtcalError for a camera that there isn't, or where the calibration was read from a file."""
        return _asked("residuals_figure", self, camera)

    def plot_residuals_over_time(self, camera: str) -> Figure:
        """RMSE of each view of a camera against time. Raises as ``plot_residuals``."""
        return _asked("residuals_over_time_figure", self, camera)

    def plot_uncertainty(self, camera: str, *, distance_m: float = 1.0) -> Figure:
        """1-sigma in px of the pixels of points at this distance, over the image of a camera.

        Raises GtcalError for a camera that there isn't, or where no covariance was computed."""
        return _asked("uncertainty_figure", self, camera, distance_m)

    def plot_volume_uncertainty(self) -> Figure:
        """1-sigma in mm of points round the cameras.

        Raises GtcalError where no covariance was computed."""
        return _asked("volume_figure", self)


class PresentedVerification(Presented):
    """The figures of a verification, in the report's style."""

    def plot_heat_maps(self) -> Figure:
        """RMSE of e_2D over the image of every camera, in the paper's colours."""
        return _asked("heat_maps_figure", self)

    def plot_errors_over_time(self, camera: str) -> Figure:
        """e_2D of a camera's sightings against time.

        Raises GtcalError for a camera that there isn't, or where the verification was read from a file."""
        return _asked("errors_over_time_figure", self, camera)


def _asked(what: str, *arguments: object) -> Any:
    return getattr(import_module(_PRESENTATION), what)(*arguments)
