from setuptools import find_packages, setup
from setuptools.command.install_scripts import install_scripts

package_name = "stressbot_driver"

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


setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="stressbot maintainers",
    maintainer_email="stressbot@example.org",
    description="Plays voltage sequences on a substrate of MicroStressBots and reports what the robots do.",
    license="Apache-2.0",
    extras_require={
        "camera": ["opencv-python-headless<5", "scipy"],
        "instruments": ["pyvisa", "pyvisa-py"],
        "test": ["hypothesis", "pytest"],
    },
    cmdclass={"install_scripts": GuardedScripts},
    entry_points={
        "console_scripts": [
            "camera_calibrate = stressbot_driver.ros.camera_calibrate:calibrate_main",
            "camera_check = stressbot_driver.ros.camera_calibrate:check_main",
            "camera_tracker = stressbot_driver.ros.camera_tracker_node:main",
            "driver = stressbot_driver.ros.driver_node:main",
            "image_source = stressbot_driver.ros.image_source_node:main",
            "instrument_emulator = stressbot_driver.ros.instrument_emulator_node:main",
            "simulated_camera = stressbot_driver.ros.simulated_camera_node:main",
            "viewer = stressbot_driver.ros.viewer_node:main",
        ],
        # A backend is an output onto a substrate; other packages add theirs under the same group.
        "stressbot_driver.backends": [
            "simulated = stressbot_driver.backends.simulated:SimulatedBackend",
            "waveform_generator = stressbot_driver.backends.waveform_generator:WaveformGeneratorBackend",
        ],
    },
)
