"""``python -m fewview`` is the ``fewview`` command."""

import sys

from fewview.cli import main

sys.exit(main())
