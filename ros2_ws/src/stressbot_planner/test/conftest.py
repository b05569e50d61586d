"""What all tests of the package share."""

import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent / "support"))

# the first example of a compiled loop takes seconds, the others microseconds
settings.register_profile("stressbot", deadline=None, max_examples=60)
settings.load_profile("stressbot")
