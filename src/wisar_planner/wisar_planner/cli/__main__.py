"""`python -m wisar_planner.cli` is `wisar`."""

import sys

from wisar_planner.cli.main import main

sys.exit(main())
