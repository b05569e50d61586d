"""`make faults`: nodes are killed and frozen, messages lost and late, clocks set, a disk full and a link cut while a sequence runs.

Every fault must end in the state that docs/safety.md names, at zero volts, and the system must run again afterwards. `settings`
makes systems, one module for each kind of fault says what happens to them, `campaign` lets it happen.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
for folder in ("tests/support", "ros2_ws/src/stressbot_driver/test/support"):
    sys.path.insert(0, str(ROOT / folder))
