"""Code that runs in a process of its own, with little memory and little time."""

from __future__ import annotations

import subprocess
import sys
import textwrap

MEMORY = 3 << 30  # bytes of address space: libraries alone map one and a half GiB
SECONDS = 120  # much more than anything below takes

_FIRST = """
import resource, sys, warnings
from pathlib import Path
import numpy as np
import voluminous as vm

warnings.simplefilter("ignore")
resource.setrlimit(resource.RLIMIT_AS, ({memory}, {memory}))
folder = Path(sys.argv[1])


def refusal(path, **options):
    '''Return what is said where a file is refused.'''
    try:
        volume = vm.open(path, **options)
    except vm.VoluminousError as error:
        return f"{{type(error).__name__}}: {{error}}"
    raise AssertionError(f"{{path}} was read: {{volume}}")


"""


def run(script, folder, memory=MEMORY, seconds=SECONDS):
    """Run a script on a folder; what it prints is returned, and what it raises is raised."""
    code = _FIRST.format(memory=memory) + textwrap.dedent(script)
    command = [sys.executable, "-c", code, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    assert done.returncode == 0, f"{done.returncode}: {done.stderr[-3000:]}"
    return done.stdout
