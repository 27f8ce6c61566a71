"""One thread of linear algebra in each process of the tests, to be imported before numpy, which reads it once.

OpenBLAS waits for its threads busily. Where two processes of pytest-xdist share two cores, each with two such threads,
they wait for each other most of the time: a calibration of three seconds takes 45.
"""

import os

for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
