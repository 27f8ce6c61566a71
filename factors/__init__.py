"""What GTSAM lacks for camera-to-mocap calibration: camera models, and residuals as factors."""

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
