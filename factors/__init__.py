"""What GTSAM lacks for camera-to-mocap calibration: camera models, and residuals as factors."""

from factors.camera_models import (
    CAMERA_MODELS as CAMERA_MODELS,
)
from factors.camera_models import (
    FISHEYE62 as FISHEYE62,
)
from factors.camera_models import (
    FISHEYE624 as FISHEYE624,
)
from factors.camera_models import (
    KANNALA_BRANDT4 as KANNALA_BRANDT4,
)
from factors.camera_models import (
    PINHOLE_RADTAN as PINHOLE_RADTAN,
)
from factors.camera_models import (
    CameraModel as CameraModel,
)
