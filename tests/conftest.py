"""Set before numpy is imported: the suite's workers share the cores, where threads over matrices as small as ours only wait."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
