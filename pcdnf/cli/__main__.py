"""``python -m pcdnf.cli``."""

import sys

from .main import main

sys.exit(main())
