"""The methods that find X and every Y_c from poses alone, by what people call them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from gtcal.baselines.dornaika_horaud import dornaika_horaud
from gtcal.baselines.dual_quaternions import daniilidis
from gtcal.baselines.hand_eye import park_martin, shah, tsai_lenz
from gtcal.baselines.pose_pairs import PosePairs
from gtcal.baselines.robot_world import li, zhuang
from gtcal.camera import FloatArray

PoseMethod = Callable[[Mapping[str, PosePairs]], tuple[FloatArray, dict[str, FloatArray]]]

CLOSED_FORMS: dict[str, PoseMethod] = {
    "Tsai-Lenz (AX = XB)": tsai_lenz,
    "Park-Martin (AX = XB)": park_martin,
    "Daniilidis (AX = XB)": daniilidis,
    "Zhuang (AX = ZB)": zhuang,
    "Shah (AX = ZB)": shah,
    "Li (AX = ZB)": li,
    "Dornaika-Horaud (poses)": dornaika_horaud,
}
