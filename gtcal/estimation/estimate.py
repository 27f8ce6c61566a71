"""The unknowns of a calibration, where the solver's own modules look for them."""

from gtcal.observed.estimate import Estimate as Estimate
