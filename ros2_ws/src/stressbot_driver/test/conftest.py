import signal
import sys
from pathlib import Path

signal.signal(signal.SIGINT, signal.default_int_handler)  # processes of tests hear Ctrl-C, also where tests run in the background
sys.path.insert(0, str(Path(__file__).parent / "support"))
