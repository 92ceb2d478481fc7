"""``python -m voluminous`` is the command ``voluminous``."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
