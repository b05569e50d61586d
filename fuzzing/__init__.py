"""`make fuzz`: hostile input at every interface. docs/fuzzing.md says what is tried and what must hold.

strategies      what hostile data looks like: numbers, texts, structures, ROS messages (hypothesis); shared with the tests
interface       what an interface is, what may come out of it, and the deadline
files, orders, volts, instruments, settings    the interfaces, by what arrives there
generated       hypothesis throws inputs at the interfaces, in this process
guided          atheris, guided by coverage, at the parsers, in processes of their own
nodes           a share of it over DDS at running nodes
loops           closed loops of any robots under any assumption, in this process and over DDS
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "tests/support"), str(ROOT / "benchmarks"), str(ROOT / "ros2_ws/src/stressbot_driver/test/support")]
