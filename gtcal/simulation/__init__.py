"""Simulated recordings with their ground truth."""

from gtcal.simulation.corners import CornerNoise as CornerNoise
from gtcal.simulation.ground_truth import read_ground_truth as read_ground_truth
from gtcal.simulation.noise import MocapNoise as MocapNoise
from gtcal.simulation.options import IntrinsicsError as IntrinsicsError
from gtcal.simulation.options import SimulationOptions as SimulationOptions
from gtcal.simulation.rendering import ImageOptions as ImageOptions
from gtcal.simulation.rig import Rig as Rig
from gtcal.simulation.rig import fixed_cameras_rig as fixed_cameras_rig
from gtcal.simulation.rig import quest3_like_rig as quest3_like_rig
from gtcal.simulation.simulate import Simulation as Simulation
from gtcal.simulation.simulate import simulate as simulate
from gtcal.simulation.truth import CameraTruth as CameraTruth
from gtcal.simulation.truth import GroundTruth as GroundTruth
from gtcal.simulation.visibility import ViewLimits as ViewLimits
from gtcal.simulation.writing import write_simulation as write_simulation
