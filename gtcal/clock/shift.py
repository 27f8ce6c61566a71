"""Views at other times: the cameras' stamps on the mocap's clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gtcal.clock.rolling_shutter import straightened
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Dropped, Observations, Views
from gtcal.estimation.residuals import select_views
from gtcal.results.calibration import Calibration, moved_ns


def shifted(
    observations: Observations, offset_s: Mapping[str, float], *, drift: float = 0.0, middle_ns: int = 0
) -> Observations:
    """The observations with each camera's stamps moved by its offset (stamp + offset is the mocap's time), which grows
    by ``drift`` per second about ``middle_ns``; and the mocap's poses of those times. Views without a pose then are
    dropped and counted.

    Raises GtcalError where a camera keeps no view."""
    views: dict[str, Views] = {}
    dropped: list[Dropped] = []
    for name, of_camera in observations.views.items():
        stamps_ns = moved_ns(of_camera.stamps_ns, offset_s[name], drift, middle_ns)
        poses = observations.motion.at(stamps_ns)
        moved = replace(of_camera, stamps_ns=stamps_ns, ref_T_body=poses.ref_T_body)
        if not poses.ok.all():
            lost = ~poses.ok
            n_corners = int(np.diff(of_camera.view_start)[lost].sum())
            dropped.append(Dropped(name, "no mocap pose at the shifted time", int(lost.sum()), n_corners))
            if lost.all():
                raise GtcalError(f"camera {name!r}: none of its views has a mocap pose {offset_s[name]:+.3f} s later")
            moved = select_views(moved, np.flatnonzero(poses.ok))
        views[name] = moved
    frames = np.unique(np.concatenate([of_camera.stamps_ns for of_camera in views.values()]))
    indexed = {
        name: replace(of_camera, frame_index=np.searchsorted(frames, of_camera.stamps_ns))
        for name, of_camera in views.items()
    }
    return replace(observations, views=indexed, frame_stamps_ns=frames, dropped=(*observations.dropped, *dropped))


def on_clock_of(calibration: Calibration, observations: Observations) -> Observations:
    """The observations, whose cameras are the calibration's, at the times that it was computed at, rolling shutters
    straightened."""
    clock = calibration.clock
    if clock is not None and clock.corrected:
        observations = shifted(observations, clock.offset_s, drift=clock.drift, middle_ns=clock.middle_ns)
    return straightened(observations, calibration.estimate)
