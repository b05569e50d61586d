import signal
import sys
from pathlib import Path

from hypothesis import settings

signal.signal(signal.SIGINT, signal.default_int_handler)  # processes of tests hear Ctrl-C, also where tests run in the background
sys.path.insert(0, str(Path(__file__).parent / "support"))

settings.register_profile("stressbot", deadline=None, max_examples=60)
settings.load_profile("stressbot")
