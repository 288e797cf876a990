"""`python -m neuralgrasps`: the same as the `neuralgrasps` command."""

import sys

from neuralgrasps.cli.main import run

if __name__ == "__main__":  # worker processes import this module again
    sys.exit(run())
