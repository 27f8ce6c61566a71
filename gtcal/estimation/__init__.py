"""From a recording to the estimate: observations, stages 1 to 4, covariances."""
