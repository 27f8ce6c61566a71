"""The covariance of a whole calibration, and its kinds."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gtcal.camera import FloatArray

NAIVE = "naive"
"""The covariance of the paper's objective: corners independent, the mocap's poses exact, scaled by the residual. Mocap
noise moves all corners of a frame together, so where it matters this is too small."""

CLUSTERED = "clustered"
"""The sandwich of stage 3's estimate: what the frames' gradients really scatter by, with a small-sample correction."""

ERRORS_IN_VARIABLES = "errors_in_variables"
"""The covariance of stage 4: the mocap's noise is modelled, by sigmas that were given or estimated."""


@dataclass(frozen=True)
class JointCovariance:
    """Of X, every Y_c and every theta_c that was solved for, in their tangents (Pose3's: rotation first, rad and m).

    kind: NAIVE, CLUSTERED or ERRORS_IN_VARIABLES.
    theta_sizes: by camera, in the order of the recording, the number of its intrinsics; 0 where they were fixed.
    matrix: (P, P); columns X (6), Y_c (6) of each camera, then theta_c of each camera.
    board_shape: (5, 5) of the board's shape, where it was solved for.

    Raises ValueError where the matrix has another size."""

    kind: str
    theta_sizes: dict[str, int]
    matrix: FloatArray
    board_shape: FloatArray | None = None

    def __post_init__(self) -> None:
        n = 6 + 6 * len(self.theta_sizes) + sum(self.theta_sizes.values())
        if self.matrix.shape != (n, n):
            raise ValueError(f"{self.matrix.shape=}, expected ({n}, {n})")

    @staticmethod
    def of(kind: str, theta_sizes: dict[str, int], matrix: FloatArray) -> JointCovariance:
        """Of a matrix that may have the board's shape after these unknowns."""
        n = 6 + 6 * len(theta_sizes) + sum(theta_sizes.values())
        return JointCovariance(kind, theta_sizes, matrix[:n, :n], matrix[n:, n:] if len(matrix) > n else None)

    def times(self, factor: float) -> JointCovariance:
        """All of it larger by a factor."""
        shape = None if self.board_shape is None else factor * self.board_shape
        return replace(self, matrix=factor * self.matrix, board_shape=shape)

    @property
    def columns_of_body_T_board(self) -> slice:
        return slice(0, 6)

    def columns_of_camera_T_ref(self, camera: str) -> slice:
        """Raises KeyError for a camera that is not there."""
        start = 6 + 6 * self._index(camera)
        return slice(start, start + 6)

    def columns_of_theta(self, camera: str) -> slice:
        """Empty where the intrinsics were fixed. Raises KeyError for a camera that is not there."""
        before = list(self.theta_sizes.values())[: self._index(camera)]
        start = 6 + 6 * len(self.theta_sizes) + sum(before)
        return slice(start, start + self.theta_sizes[camera])

    @property
    def body_T_board(self) -> FloatArray:
        """(6, 6)."""
        return self.matrix[:6, :6]

    def camera_T_ref(self, camera: str) -> FloatArray:
        """(6, 6)."""
        columns = self.columns_of_camera_T_ref(camera)
        return self.matrix[columns, columns]

    def theta(self, camera: str) -> FloatArray | None:
        """(K, K); None where the intrinsics were fixed."""
        columns = self.columns_of_theta(camera)
        return self.matrix[columns, columns] if self.theta_sizes[camera] else None

    def _index(self, camera: str) -> int:
        if camera not in self.theta_sizes:
            raise KeyError(camera)
        return list(self.theta_sizes).index(camera)
