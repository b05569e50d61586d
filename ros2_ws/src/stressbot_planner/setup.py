import sys
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.install_scripts import install_scripts

package_name = "stressbot_planner"

GUARD = """\
#!/bin/sh
'''trap' '' INT && exec {python} -S "$0" "$@"
' '''
# For sh, the second line starts Python. No traceback at Ctrl-C, however early: Python ignores it until the next lines, and then
# ends without a word until the program can take it, also while it loads its own `site` (which -S puts off).
import _signal
import sys

if sys.flags.no_site:
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    import site

    site.main()
"""


class GuardedScripts(install_scripts):
    def write_script(self, script_name, contents, mode="t", *ignored):
        shebang, program = contents.split("\n", 1)
        super().write_script(script_name, GUARD.format(python=shebang.removeprefix("#!").strip()) + program, mode)


MESSAGES = Path("../stressbot_msgs")
SHARED = ("python/errors.py", "python/lifeline.py", "python/scenario_text.py", "python/wording.py", "schema/scenario.schema.json")


def shared_folder() -> str:
    """Make the package stressbot_msgs as far as it knows nothing of ROS; colcon builds the whole of it."""
    folder = Path("build/shared/stressbot_msgs")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "__init__.py").write_text("")
    for name in SHARED:
        if not (MESSAGES / name).is_file():
            raise SystemExit(f"stressbot_planner: {MESSAGES / name} is not there: install from a clone of the whole repository")
        (folder / Path(name).name).write_bytes((MESSAGES / name).read_bytes())
    return str(folder)


packages = find_packages(include=[f"{package_name}*"])
data_files = [
    ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
    (f"share/{package_name}", ["package.xml"]),
    (f"share/{package_name}/foxglove", glob("foxglove/*.json")),
    (f"share/{package_name}/launch", glob("launch/*.launch.py")),
    (f"share/{package_name}/config", glob("config/*.yaml")),
    (f"share/{package_name}/rviz", glob("rviz/*.rviz")),
    (f"share/{package_name}/security", glob("security/*")),
    (f"share/{package_name}/scenarios", glob("scenarios/*.yaml")),
    (f"share/{package_name}/scenarios/rivals", glob("scenarios/rivals/*.yaml")),
]
commands = [
    "calibrate = stressbot_planner.ros.calibrate:main",
    "clicks = stressbot_planner.ros.clicks_node:main",
    "mover = stressbot_planner.ros.mover_node:main",
    "paths = stressbot_planner.ros.paths_node:main",
    "planner = stressbot_planner.ros.planner_node:main",
    "recognise = stressbot_planner.ros.recognise:main",
    "recorder = stressbot_planner.ros.recorder_node:main",
    "sequencer = stressbot_planner.ros.sequencer_node:main",
    "stressbot = stressbot_planner.cli.tool:main",
    "tracker_relay = stressbot_planner.ros.tracker_relay_node:main",
]
package_data = {package_name: ["py.typed", "view/page/*"]}
more = {}
if {"bdist_wheel", "dist_info"} & set(sys.argv):  # by pip: the library and the tool, to plan without ROS
    more = {"package_dir": {"stressbot_msgs": shared_folder()}}
    package_data["stressbot_msgs"] = ["*.json"]
    packages.append("stressbot_msgs")
    data_files = []
    commands = [command for command in commands if command.startswith("stressbot =")]

setup(
    name=package_name,
    version="0.1.0",
    packages=packages,
    package_data=package_data,
    data_files=data_files,
    install_requires=["jsonschema", "joblib", "matplotlib", "numba", "numpy>=1.26", "pyyaml", "rich", "scipy", "websockets"],
    python_requires=">=3.11",
    zip_safe=True,
    maintainer="stressbot maintainers",
    maintainer_email="stressbot@example.org",
    description="Motion planning and sequencing for swarms of MicroStressBots under group control.",
    license="Apache-2.0",
    cmdclass={"install_scripts": GuardedScripts},
    **more,
    entry_points={
        "console_scripts": commands,
        "stressbot_planner.planners": [
            "optimize = stressbot_planner.planners.optimization.optimize:plan",
            "optimize_paper = stressbot_planner.planners.optimization.optimize_paper:plan",
            "parallel = stressbot_planner.planners.trees.parallel:plan",
            "pure_control = stressbot_planner.planners.pure_control:plan",
            "rrt = stressbot_planner.planners.trees.rrt:plan",
            "rrt_rotation = stressbot_planner.planners.trees.rrt_rotation:plan",
            "sequential = stressbot_planner.planners.trees.sequential:plan",
        ],
    },
)
