"""Start the simulated autopilot: ``python -m wisar_sim.autopilot``."""

import sys

from wisar_sim.autopilot.cli import main

sys.exit(main())
