"""``python -m stereocal`` is the command ``stereocal``."""

import sys

from stereocal.cli.main import main

sys.exit(main())
