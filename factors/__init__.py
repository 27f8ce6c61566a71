"""What GTSAM lacks for camera-to-mocap calibration: camera models, and residuals as factors."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from factors.alignment import PointAlignmentFactor as PointAlignmentFactor
    from factors.camera_models import CAMERA_MODELS as CAMERA_MODELS
    from factors.camera_models import DOUBLE_SPHERE as DOUBLE_SPHERE
    from factors.camera_models import EXTENDED_UNIFIED as EXTENDED_UNIFIED
    from factors.camera_models import FISHEYE62 as FISHEYE62
    from factors.camera_models import FISHEYE624 as FISHEYE624
    from factors.camera_models import KANNALA_BRANDT4 as KANNALA_BRANDT4
    from factors.camera_models import MEI_OMNI as MEI_OMNI
    from factors.camera_models import PINHOLE_RADTAN as PINHOLE_RADTAN
    from factors.camera_models import PINHOLE_RATIONAL as PINHOLE_RATIONAL
    from factors.camera_models import CameraModel as CameraModel
    from factors.camera_models import register_camera_model as register_camera_model
    from factors.priors import JointPriorFactor as JointPriorFactor
    from factors.priors import PoseMeasurementFactor as PoseMeasurementFactor
    from factors.priors import factory_intrinsics_prior as factory_intrinsics_prior
    from factors.priors import weak_intrinsics_prior as weak_intrinsics_prior
    from factors.reprojection import CornerReprojectionFactor as CornerReprojectionFactor
    from factors.reprojection import CornerViews as CornerViews
    from factors.reprojection import FusedReprojectionFactor as FusedReprojectionFactor
    from factors.robust import GAUSSIAN as GAUSSIAN
    from factors.robust import ROBUST_KERNELS as ROBUST_KERNELS
    from factors.robust import AnyKernel as AnyKernel
    from factors.robust import CalledBackKernel as CalledBackKernel
    from factors.robust import RobustKernel as RobustKernel
    from factors.robust import kernel_of as kernel_of

_HOMES = {
    "PointAlignmentFactor": "alignment",
    "CAMERA_MODELS": "camera_models",
    "DOUBLE_SPHERE": "camera_models",
    "EXTENDED_UNIFIED": "camera_models",
    "FISHEYE62": "camera_models",
    "FISHEYE624": "camera_models",
    "KANNALA_BRANDT4": "camera_models",
    "MEI_OMNI": "camera_models",
    "PINHOLE_RADTAN": "camera_models",
    "PINHOLE_RATIONAL": "camera_models",
    "CameraModel": "camera_models",
    "register_camera_model": "camera_models",
    "JointPriorFactor": "priors",
    "PoseMeasurementFactor": "priors",
    "factory_intrinsics_prior": "priors",
    "weak_intrinsics_prior": "priors",
    "CornerReprojectionFactor": "reprojection",
    "CornerViews": "reprojection",
    "FusedReprojectionFactor": "reprojection",
    "GAUSSIAN": "robust",
    "ROBUST_KERNELS": "robust",
    "AnyKernel": "robust",
    "CalledBackKernel": "robust",
    "RobustKernel": "robust",
    "kernel_of": "robust",
}

__all__ = list(_HOMES)


def __dir__() -> list[str]:
    """What a tab key finds."""
    return sorted({*globals(), *_HOMES})


def __getattr__(name: str) -> Any:
    """Public names load their modules when first used: a camera model needs no GTSAM, and who detects only, neither."""
    if name not in _HOMES:
        raise AttributeError(f"module 'factors' has no attribute {name!r}")
    return getattr(import_module(f"factors.{_HOMES[name]}"), name)
