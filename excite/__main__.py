"""`python -m excite`: the command line, where no script of that name is on the path."""

import sys

from .cli.main import main

sys.exit(main())
