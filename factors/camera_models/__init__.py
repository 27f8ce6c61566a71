"""Camera models: from a point in the camera frame to a pixel, with analytic Jacobians, and back.

Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centres.

To add a model, write its parts (``parts``) and its ``CameraModel`` in a module here and name it in the list below, as
``fisheye``, ``pinhole`` and ``sphere`` are: the projection, its Jacobians, the field's end, the way back, the factors,
manifests, the search for its intrinsics, the simulation and the tests of the laws take it from there. Which camera
files hold it is said in ``gtcal.camera_files.lenses``. ``register_camera_model`` makes one known from outside
(``scripts/example_own_camera_model.py``).
"""

from factors.camera_models.fisheye import FISHEYE62 as FISHEYE62
from factors.camera_models.fisheye import FISHEYE624 as FISHEYE624
from factors.camera_models.fisheye import KANNALA_BRANDT4 as KANNALA_BRANDT4
from factors.camera_models.model import CAMERA_MODELS as CAMERA_MODELS
from factors.camera_models.model import CameraModel as CameraModel
from factors.camera_models.model import register_camera_model as register_camera_model
from factors.camera_models.pinhole import PINHOLE_RADTAN as PINHOLE_RADTAN
from factors.camera_models.pinhole import PINHOLE_RATIONAL as PINHOLE_RATIONAL
from factors.camera_models.sphere import DOUBLE_SPHERE as DOUBLE_SPHERE
from factors.camera_models.sphere import EXTENDED_UNIFIED as EXTENDED_UNIFIED
from factors.camera_models.sphere import MEI_OMNI as MEI_OMNI

for model in (
    FISHEYE62,
    KANNALA_BRANDT4,
    PINHOLE_RADTAN,
    FISHEYE624,
    PINHOLE_RATIONAL,
    DOUBLE_SPHERE,
    EXTENDED_UNIFIED,
    MEI_OMNI,
):
    register_camera_model(model)
