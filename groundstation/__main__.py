"""``python -m groundstation`` is the console command."""

import sys

from groundstation.cli import main

sys.exit(main())
