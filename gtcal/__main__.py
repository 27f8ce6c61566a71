"""``python -m gtcal``."""

import sys

from gtcal.cli import main

sys.exit(main())
